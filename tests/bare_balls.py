"""The balls as a splat that came without photos, and boxes around them in its views."""

from dataclasses import replace

import torch

from balls import BALLS, SPLATS
from stylesplat.scene.framing import ring_cameras
from stylesplat.scene.scene import Scene
from stylesplat.selection.identities import render_labels

PLAIN = replace(SPLATS, identities=None, classifier=None)
VIEWS = ring_cameras(SPLATS, torch.tensor([0.0, 0.0, 1.0])).downscale(8)  # 120x90
BARE = Scene(PLAIN, VIEWS)


def around(id: int, view: str) -> tuple[str, tuple[float, float, float, float]]:
    """A box around a ball in a view."""
    labels = render_labels(SPLATS, VIEWS[VIEWS.index(view)])
    y, x = (labels == id).nonzero().T.float()
    low, high = (float(x.min()) - 3, float(y.min()) - 3), (float(x.max()) + 4, float(y.max()) + 4)
    return view, (*low, *high)


def of_ball(id: int) -> torch.Tensor:
    start = 200 + 80 * [*BALLS].index(id)
    return (torch.arange(len(SPLATS)) >= start) & (torch.arange(len(SPLATS)) < start + 80)


def agreement(picked: torch.Tensor, id: int) -> float:
    return float((picked & of_ball(id)).sum() / (picked | of_ball(id)).sum())

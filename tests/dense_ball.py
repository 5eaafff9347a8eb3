"""The still life with a ball of small Gaussians in its midst, finer than what is painted on it."""

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional as F

from balls import SPLATS
from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.splats import Splats

COUNT = 1500  # Gaussians of the ball
CENTRE = torch.tensor([0.0, 0.0, 0.4])
WAYS = F.normalize(torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0)), dim=1)
LIGHT = 0.5 + 0.2 * WAYS[:, 2:].expand(-1, 3)  # from above
PICKED = torch.arange(len(SPLATS) + COUNT) >= len(SPLATS)


def dense_ball(colors: Tensor) -> Splats:
    """The still life with the ball in some colours, one for each of its Gaussians."""
    rows = torch.arange(len(SPLATS)).repeat(4)[:COUNT]
    tensors = SPLATS[rows].tensors() | {
        "means": 0.4 * WAYS + CENTRE,
        "scales": torch.full((COUNT, 3), 0.02).log(),
        "sh0": sh0_from_rgb(colors)[:, None],
    }
    both = {name: torch.cat([t, tensors[name]]) for name, t in SPLATS.tensors().items()}
    return replace(SPLATS, **both)

"""Cameras for a splat that came without photos."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.poses import look_at
from stylesplat.scene.splats import Splats

VIEWS = 36
SIZE = (960, 720)  # pixels
FOCAL = 1.0  # of the width
CONTENT = 0.8  # share of the opacity that the views show; the rest is far around
ROOM = 1.25  # of the distance at which that would fill the picture
NEAREST = 0.1  # world units; nothing nearer than 0.01 is drawn
ELEVATIONS = (10.0, 35.0)  # degrees, of every other camera


def ring_cameras(splats: Splats, up: Float[Tensor, "3"]) -> Cameras:
    """Cameras on two circles around the content, looking at its middle.

    Args:
        splats: What to look at; its middle is the median of the centres, by opacity.
        up: The direction that is up.
    """
    weights = torch.sigmoid(splats.opacities).double()
    means = splats.means.double()
    focus = torch.stack([_quantile(axis, weights, 0.5) for axis in means.T])
    reach = (means - focus).norm(dim=1) + splats.scales.double().amax(dim=1).exp()
    radius = _quantile(reach, weights, CONTENT)
    width, height = SIZE
    distance = (ROOM * radius * FOCAL * width / (height / 2)).clamp(min=NEAREST)
    up = torch.nn.functional.normalize(up.double(), dim=0)
    side = torch.linalg.cross(up, torch.eye(3).double()[up.abs().argmin()])
    side = torch.nn.functional.normalize(side, dim=0)
    ahead = torch.linalg.cross(up, side)
    turn = 2 * math.pi * torch.arange(VIEWS, dtype=torch.float64) / VIEWS
    tilt = torch.deg2rad(torch.tensor(ELEVATIONS, dtype=torch.float64)).repeat(VIEWS // 2)
    level = turn.cos()[:, None] * side + turn.sin()[:, None] * ahead
    outward = tilt.cos()[:, None] * level + tilt.sin()[:, None] * up
    K = torch.tensor([[FOCAL * width, 0, width / 2], [0, FOCAL * width, height / 2], [0, 0, 1]])
    return Cameras(
        viewmats=look_at(focus + distance * outward, focus, up).float(),
        Ks=K.expand(VIEWS, 3, 3).clone(),
        sizes=torch.tensor(SIZE).expand(VIEWS, 2).clone(),
        names=tuple(f"view_{i:03d}.png" for i in range(VIEWS)),
    )


def _quantile(values: Float[Tensor, " N"], weights: Float[Tensor, " N"], share: float) -> Tensor:
    ordered, order = values.sort()
    reached = weights[order].cumsum(0) / weights.sum().clamp(min=1e-12)
    return ordered[min(int((reached < share).sum()), len(values) - 1)]

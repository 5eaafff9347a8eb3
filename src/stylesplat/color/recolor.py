"""Recolouring in closed form: the affine map of colours that its settings are."""

import math
from functools import reduce

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.color.lab import LUMA
from stylesplat.color.recolor_config import RecolorConfig, parse_color
from stylesplat.color.transfer import color_map, mapped
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats, rgb_from_sh0

# W3C, Filter Effects 1, hueRotate: what the sine of the angle is multiplied by
HUE_SINE = ((-0.213, -0.715, 0.928), (0.143, 0.140, -0.283), (-0.787, 0.715, 0.072))
WARMTH = 0.25  # logarithm of red's factor, and of 1 / blue's, at temperature 1
STEEPEST = 2.0  # times the shading of a dark object: more shows its noise
DARK = 1e-3  # luma to divide by
VIEWS, LONGER_SIDE = 4, 160  # of renders that show the colours of an object


@torch.no_grad()
def recolor_map(
    config: RecolorConfig,
    splats: Splats,
    mask: Bool[Tensor, " N"],
    cameras: Cameras,
    picture: Float[Tensor, "P 3"] | None = None,
) -> Float[Tensor, "3 4"]:
    """The affine map of a recolouring.

    Matching the colours of a picture, and tinting, depend on those that the object has.
    """
    luma, one = torch.tensor(LUMA), torch.eye(3)
    grey = torch.ones(3, 1) * luma  # [3, 3], shows the luma of a colour
    steps = []
    if picture is not None or config.tint is not None:
        own = _shown_colors(splats, mask, cameras)
        if picture is not None:
            steps.append(color_map(own, picture))
            own = mapped(own, steps[0])
        if config.tint is not None:
            steps.append(_tint(torch.tensor(parse_color(config.tint)), own.mean(dim=0)))
    sine, cosine = math.sin(math.radians(config.hue)), math.cos(math.radians(config.hue))
    gains = torch.tensor([WARMTH, 0.0, -WARMTH]).mul(config.temperature).exp()
    matrices = [
        grey + cosine * (one - grey) + sine * torch.tensor(HUE_SINE),
        grey + config.saturation * (one - grey),
        torch.diag(gains / (gains @ luma)),
        config.brightness * one,
    ]
    steps += [F.pad(matrix, (0, 1)) for matrix in matrices]
    steps.append(F.pad(config.contrast * one, (0, 1), value=(1 - config.contrast) / 2))
    last_row = torch.tensor([[0.0, 0.0, 0.0, 1.0]])
    return reduce(lambda a, b: b @ torch.cat([a, last_row]), steps)


def _tint(color: Float[Tensor, " 3"], mean: Float[Tensor, " 3"]) -> Float[Tensor, "3 4"]:
    """The map that takes the mean to a colour, and what is lighter or darker to shades of it."""
    luma = torch.tensor(LUMA)
    shade = color / (color @ luma).clamp(min=DARK)  # of luma 1
    steepness = ((color @ luma) / (mean @ luma).clamp(min=DARK)).clamp(max=STEEPEST)
    matrix = steepness * shade[:, None] * luma
    return torch.cat([matrix, (color - matrix @ mean)[:, None]], dim=1)


def _shown_colors(
    splats: Splats, mask: Bool[Tensor, " N"], cameras: Cameras
) -> Float[Tensor, "P 3"]:
    """The colours of an object alone in a few views; where none shows it, its Gaussians'."""
    own, shown = splats[mask.nonzero()[:, 0]], []
    for row in evenly(range(len(cameras)), VIEWS):
        image, alphas = render(own, cameras[row].at_most(LONGER_SIDE))
        shown.append((image / alphas)[alphas[..., 0] > COVERED])
    colors = torch.cat(shown)
    return (colors if len(colors) else rgb_from_sh0(own.sh0[:, 0])).clamp(0, 1)

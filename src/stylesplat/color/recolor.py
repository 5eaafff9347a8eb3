"""Recolouring in closed form: its settings, and the affine map of colours that they are."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import reduce
from pathlib import Path
from typing import Any, get_type_hints

import torch
from jaxtyping import Bool, Float
from PIL import ImageColor
from torch import Tensor
from torch.nn import functional as F

from stylesplat.argument_kinds import check_limits, convert_settings
from stylesplat.color.lab import LUMA
from stylesplat.color.transfer import color_map, mapped
from stylesplat.errors import StyleSplatError, brief
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats, rgb_from_sh0

RECOLOR_LIMITS = {  # of settings; with larger factors hardly anything but clipped colours is left
    "hue": (-360, 360),
    "saturation": (0, 4),
    "temperature": (-1, 1),
    "brightness": (0, 4),
    "contrast": (0, 4),
}
# W3C, Filter Effects 1, hueRotate: what the sine of the angle is multiplied by
HUE_SINE = ((-0.213, -0.715, 0.928), (0.143, 0.140, -0.283), (-0.787, 0.715, 0.072))
WARMTH = 0.25  # logarithm of red's factor, and of 1 / blue's, at temperature 1
STEEPEST = 2.0  # times the shading of a dark object: more shows its noise
DARK = 1e-3  # luma to divide by
VIEWS, LONGER_SIDE = 4, 160  # of renders that show the colours of an object


@dataclass(frozen=True)
class RecolorConfig:
    """How to change colours, in this order. Hue to contrast are as the filters of CSS."""

    match: str | None = None
    """File of a picture whose colours the object is to have, in mean and covariance."""
    tint: str | None = None
    """Colour that the object is to have, but for its light and shade: #rrggbb or a name."""
    hue: float = 0.0
    """Degrees to turn the hues by; luma stays."""
    saturation: float = 1.0
    """Distance of the colours from grey: 0 for grey, 1 as it is, up to 4."""
    temperature: float = 0.0
    """-1 for bluish light to 1 for yellowish light."""
    brightness: float = 1.0
    """Factor on the colours, 0 to 4."""
    contrast: float = 1.0
    """Factor on their distance from mid-grey, 0 to 4."""

    def __post_init__(self) -> None:
        check_limits(self, "recolor", RECOLOR_LIMITS)
        if self.tint is not None:
            parse_color(self.tint)

    @property
    def changed(self) -> dict[str, Any]:
        """The settings that are not the defaults."""
        return {k: v for k, v in asdict(self).items() if v != getattr(RecolorConfig, k)}


def recolor_config(settings: Mapping[str, Any]) -> RecolorConfig:
    """The settings of a recolouring, which are not all the defaults."""
    settings = {name: str(v) if isinstance(v, Path) else v for name, v in settings.items()}
    config = RecolorConfig(**convert_settings(settings, get_type_hints(RecolorConfig)))
    if not config.changed:
        raise StyleSplatError(
            "Nothing to recolor. Pass a --hue, --saturation, --brightness, --contrast, "
            "--temperature, --tint or --match."
        )
    return config


def parse_color(text: str) -> tuple[float, ...]:
    """The red, green and blue of `#rrggbb` or a name, in 0..1."""
    try:
        return tuple(level / 255 for level in ImageColor.getrgb(text)[:3])
    except ValueError:
        raise StyleSplatError(
            f"There is no color {brief(text)!r}. Use #rrggbb or a name such as teal."
        ) from None


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

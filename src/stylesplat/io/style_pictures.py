"""Pictures to take a style from: read, cropped, turned and resized; materials of the package."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.io.images import decode, decoding, on_white, open_image
from stylesplat.progress import say

PREFIX = "material:"
MATERIALS = ("bronze", "marble", "gold-leaf", "clay", "jade")  # of scripts/draw_materials.py
FOLDER = Path(__file__).with_name("materials")
MIN_SIDE = 32  # pixels; in less is no texture: one feature of VGG's block 3 sees 40
HIDDEN_SAID = 0.01  # share of a picture that is transparent from which the user is told
STYLE_MAX_SIDE = 4096  # pixels; few styles are resized to more, so more is memory only


Picture = Path | str | Float[Tensor, "_ _ 3"] | UInt8[Tensor, "_ _ 3"]
"""A file, the name of a material, or colours: floats in 0..1, or bytes."""
StylePixels = UInt8[Tensor, "_ _ 3"] | Float[Tensor, "_ _ 3"]
StyleColors = Float[Tensor, "_ _ 3"]


def is_material(picture: Any) -> bool:
    """Whether a style is the name of a material, such as `material:bronze`."""
    return isinstance(picture, str | Path) and str(picture).startswith(PREFIX)


def picture_file(picture: Path | str) -> Path:
    """The file of a picture; those of materials come with the package."""
    if not is_material(picture):
        return Path(picture)
    name = str(picture).removeprefix(PREFIX)
    if name not in MATERIALS:
        known = ", ".join(PREFIX + each for each in MATERIALS)
        raise StyleSplatError(f"There is no material {name!r}. Use a picture, or one of {known}.")
    return FOLDER / f"{name}.jpg"


def read_style(
    picture: Picture, *, rotate: float = 0.0, region: tuple[int, int, int, int] | None = None
) -> Float[Tensor, "_ _ 3"]:
    """Read a picture to take a style from, as colours in 0..1.

    It is first cropped to the `region` x0, y0, x1, y1, in pixels of the upright picture; then sides
    over 4096 pixels are scaled down, which the user is told. Last it is turned counter-clockwise by
    degrees: the largest upright rectangle of the picture's shape is kept of what is turned.
    """
    if isinstance(picture, Tensor):
        name, pixels = "the style tensor", _colors_of(picture)
    else:
        name, pixels = str(picture), _decoded(picture_file(picture))
    if region is not None:
        pixels = _crop(pixels, region, name)
    colors = pixels.float() / 255 if pixels.dtype == torch.uint8 else pixels.clamp(0, 1)
    return _turn(_shrink(colors, name), rotate, name).contiguous()


def _decoded(path: Path) -> StylePixels:
    with open_image(path) as image:
        frames, size = getattr(image, "n_frames", 1), image.size
    if frames > 1:
        raise StyleSplatError(
            f"The picture {path} has {frames} frames (an animation or several pages). "
            "Save one frame as a picture of its own."
        )
    _require_side(*size, f"The picture {path}")
    with decoding(path):
        pixels = decode(path, upright=True)
        hidden = float((pixels[..., 3] == 0).mean()) if pixels.shape[2] > 3 else 0.0
        if hidden == 1:
            raise StyleSplatError(f"All of the picture {path} is transparent. Use another one.")
        if hidden > HIDDEN_SAID:
            say(f"{path}: {hidden:.0%} of it is transparent, which counts as white paint")
        return on_white(pixels)


def _colors_of(tensor: Tensor) -> StylePixels:
    """The colours of a tensor, checked."""
    colors, is_bytes = tensor.detach().cpu(), tensor.dtype == torch.uint8
    is_known = is_bytes or tensor.is_floating_point()
    colors = colors if is_bytes else colors.double()
    within = (colors >= 0) & (colors <= (255 if is_bytes else 1))
    if not is_known or colors.ndim != 3 or colors.shape[2] != 3 or not within.all():
        raise StyleSplatError(
            f"A style tensor holds [H, W, 3] bytes or floats in 0..1, this one {[*colors.shape]} "
            f"{tensor.dtype} from {colors.min():g} to {colors.max():g}. Move its channels to the "
            "end, or divide it by 255."
        )
    _require_side(colors.shape[1], colors.shape[0], "The style tensor")
    return colors if is_bytes else colors.float()


def _require_side(width: int, height: int, what: str) -> None:
    if min(width, height) < MIN_SIDE:
        raise StyleSplatError(
            f"{what} is {width}x{height} pixels, too little to take a style from. "
            f"Use at least {MIN_SIDE}x{MIN_SIDE}."
        )


def _crop(pixels: StylePixels, region: tuple[int, int, int, int], name: str) -> StylePixels:
    (x0, y0, x1, y1), (height, width) = region, pixels.shape[:2]
    name = f"The region {x0},{y0},{x1},{y1} of {name}"
    if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
        raise StyleSplatError(
            f"{name} is empty or reaches outside. Pass x0,y0,x1,y1 within 0,0,{width},{height}, "
            "with x0 < x1 and y0 < y1."
        )
    _require_side(x1 - x0, y1 - y0, name)
    return pixels[y0:y1, x0:x1]


def _shrink(colors: StyleColors, name: str) -> StyleColors:
    height, width = colors.shape[:2]
    if max(width, height) <= STYLE_MAX_SIDE:
        return colors
    size = _fitted_size(width, height, float(STYLE_MAX_SIDE))
    _require_side(*size, f"Scaled down to {STYLE_MAX_SIDE} pixels of length, {name}")
    say(f"{name}: scaled down from {width}x{height} to {size[0]}x{size[1]} pixels")
    planes = F.interpolate(colors.permute(2, 0, 1)[None], size[::-1], mode="area")
    return planes[0].permute(1, 2, 0)


def _turn(colors: StyleColors, degrees: float, name: str) -> StyleColors:
    if degrees % 90 == 0:
        return colors.rot90(int(degrees // 90) % 4)
    if not math.isfinite(degrees):
        raise StyleSplatError(f"Cannot turn {name} by {degrees} degrees. Pass a number of degrees.")
    height, width = colors.shape[:2]
    sin, cos = (f(math.radians(degrees)) for f in (math.sin, math.cos))
    box = np.array([[abs(cos), abs(sin)], [abs(sin), abs(cos)]]) @ (width, height)
    inner = min(np.array([width, height]) / box)
    inner_width, inner_height = int(inner * width), int(inner * height)
    _require_side(inner_width, inner_height, f"Turned by {degrees}, what is left of {name}")
    # Places of the pixels that are kept in the picture, -1 and 1 at its sides
    x = torch.arange(inner_width) - (inner_width - 1) / 2
    y = torch.arange(inner_height)[:, None] - (inner_height - 1) / 2
    places = torch.stack([2 * (cos * x - sin * y) / width, 2 * (sin * x + cos * y) / height], -1)
    options = {"mode": "bicubic", "padding_mode": "border", "align_corners": False}
    turned = F.grid_sample(colors.permute(2, 0, 1)[None], places[None], **options)
    return turned[0].permute(1, 2, 0).clamp(0, 1)


def resize(image: Float[Tensor, "H W 3"], length: float) -> Float[Tensor, "_ _ 3"]:
    height, width = image.shape[:2]
    size = _fitted_size(width, height, length)
    planes = image.permute(2, 0, 1)[None]
    resized = F.interpolate(planes, size[::-1], mode="bicubic", antialias=True)
    return resized[0].permute(1, 2, 0).clamp(0, 1)


def _fitted_size(width: int, height: int, length: float) -> tuple[int, int]:
    factor = length / max(height, width)
    return max(1, round(width * factor)), max(1, round(height * factor))

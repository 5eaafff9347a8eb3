"""Pictures to take a style from: read, cropped, turned and resized; materials of the package."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.io.images import open_image, read_image
from stylesplat.progress import say

PREFIX = "material:"
MATERIALS = ("bronze", "marble", "gold-leaf", "clay", "jade")  # of scripts/draw_materials.py
FOLDER = Path(__file__).with_name("materials")
MIN_SIDE = 32  # pixels; in less is no texture: one feature of VGG's block 3 sees 40
STYLE_MAX_SIDE = 4096  # pixels; styles are resized to some hundred, so more is memory only


Picture = Path | str | Float[Tensor, "_ _ 3"] | UInt8[Tensor, "_ _ 3"]
"""A file, the name of a material, or colours: floats in 0..1, or bytes."""
StylePixels = UInt8[np.ndarray, "_ _ 3"] | Float[np.ndarray, "_ _ 3"]


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
    pixels = np.ascontiguousarray(_turn(_shrink(pixels, name), rotate, name))
    colors = torch.from_numpy(pixels)
    return colors.float() / 255 if colors.dtype == torch.uint8 else colors.clamp(0, 1)


def _decoded(path: Path) -> StylePixels:
    with open_image(path) as image:
        frames, size = getattr(image, "n_frames", 1), image.size
    if frames > 1:
        raise StyleSplatError(
            f"The picture {path} has {frames} frames (an animation or several pages). "
            "Save one frame as a picture of its own."
        )
    _require_side(*size, f"The picture {path}")
    return read_image(path).numpy()


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
    return (colors if is_bytes else colors.float()).numpy()


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


def _shrink(pixels: StylePixels, name: str) -> StylePixels:
    height, width = pixels.shape[:2]
    if max(width, height) <= STYLE_MAX_SIDE:
        return pixels
    size = _fitted_size(width, height, float(STYLE_MAX_SIDE))
    _require_side(*size, f"Scaled down to {STYLE_MAX_SIDE} pixels of length, {name}")
    say(f"{name}: scaled down from {width}x{height} to {size[0]}x{size[1]} pixels")
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def _turn(pixels: StylePixels, degrees: float, name: str) -> StylePixels:
    if degrees % 90 == 0:
        return np.rot90(pixels, int(degrees // 90) % 4)
    if not math.isfinite(degrees):
        raise StyleSplatError(f"Cannot turn {name} by {degrees} degrees. Pass a number of degrees.")
    height, width = pixels.shape[:2]
    sin, cos = (abs(f(math.radians(degrees))) for f in (math.sin, math.cos))
    inner = min(width / (width * cos + height * sin), height / (width * sin + height * cos))
    inner_width, inner_height = int(inner * width), int(inner * height)
    _require_side(inner_width, inner_height, f"Turned by {degrees}, what is left of {name}")
    # Centres of pixels lie at +0.5
    T_to_turned = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), degrees, 1.0)
    T_to_turned[:, 2] += (inner_width - width) / 2, (inner_height - height) / 2
    return cv2.warpAffine(
        np.ascontiguousarray(pixels),
        T_to_turned,
        (inner_width, inner_height),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )


def resize(image: Float[Tensor, "H W 3"], length: float) -> Float[Tensor, "_ _ 3"]:
    height, width = image.shape[:2]
    size = _fitted_size(width, height, length)
    planes = image.permute(2, 0, 1)[None]
    resized = F.interpolate(planes, size[::-1], mode="bicubic", antialias=True)
    return resized[0].permute(1, 2, 0).clamp(0, 1)


def _fitted_size(width: int, height: int, length: float) -> tuple[int, int]:
    factor = length / max(height, width)
    return max(1, round(width * factor)), max(1, round(height * factor))

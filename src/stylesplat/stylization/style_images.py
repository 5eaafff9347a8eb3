"""Style pictures from files: upright, of a sensible size, cropped and turned."""

import math
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.decoding import opened
from stylesplat.io.captures.photos import photo_sizes, read_image
from stylesplat.progress import say

MIN_SIDE = 32  # pixels; in less is no texture: one feature of VGG's block 3 sees 40
MAX_SIDE = 4096  # pixels; styles are resized to some hundred, so more is memory only


def read_style(
    path: Path | str, *, rotate: float = 0.0, region: tuple[int, int, int, int] | None = None
) -> Float[Tensor, "H W 3"]:
    """Read a picture to take a style from.

    Longer sides than 4096 pixels are scaled down, which the user is told.

    Args:
        path: A picture with one frame, of JPEG, PNG, TIFF, WebP, AVIF, BMP, GIF, PPM or TGA.
        rotate: Degrees counter-clockwise; of what is turned, the largest upright rectangle
            without empty corners is kept. Multiples of 90 keep every pixel as it is.
        region: x0, y0, x1, y1 to crop to before all else, in pixels of the upright picture.

    Returns:
        Colours in 0..1.

    Raises:
        StyleSplatError: If the file is no picture or animated, the region does not lie in it, or
            less than 32 pixels remain of a side.
    """
    path = Path(path)
    if not math.isfinite(rotate):
        raise StyleSplatError(f"Cannot turn {path} by {rotate} degrees. Pass a number of degrees.")
    _refuse_unfit(path)
    pixels = read_image(path).numpy()
    if region is not None:
        pixels = _crop(pixels, region, path)
    pixels = _shrink(pixels, path)
    pixels = _turn(pixels, rotate, path)
    return torch.from_numpy(np.ascontiguousarray(pixels)).float() / 255


def inscribed_rectangle(width: int, height: int, degrees: float) -> tuple[float, float]:
    """Width and height of the largest upright rectangle in a rectangle turned about its centre.

    Either two of its corners lie on the long sides of the turned rectangle, halfway between
    them, or all four lie on the four sides.
    """
    sin, cos = (abs(f(math.radians(degrees))) for f in (math.sin, math.cos))
    short = min(width, height)
    if short <= 2 * sin * cos * max(width, height) or math.isclose(sin, cos):
        along, across = short / 2 / sin, short / 2 / cos
        return (along, across) if width >= height else (across, along)
    double = cos**2 - sin**2
    return (width * cos - height * sin) / double, (height * cos - width * sin) / double


def _refuse_unfit(path: Path) -> None:
    """Look at the file's header, before its pixels are decoded."""
    with opened(path) as image:
        frames, size = getattr(image, "n_frames", 1), image.size
    if frames > 1:
        raise StyleSplatError(
            f"The picture {path} has {frames} frames (an animation or several pages). "
            "Save one frame as a picture of its own."
        )
    _refuse_small(*size, f"The picture {path}")


def _refuse_small(width: int, height: int, what: str) -> None:
    if min(width, height) < MIN_SIDE:
        raise StyleSplatError(
            f"{what} is {width}x{height} pixels, too little to take a style from. "
            f"Use at least {MIN_SIDE}x{MIN_SIDE}."
        )


def _crop(
    pixels: UInt8[np.ndarray, "H W 3"], region: tuple[int, int, int, int], path: Path
) -> UInt8[np.ndarray, "_ _ 3"]:
    x0, y0, x1, y1 = region
    width, height = photo_sizes(path, reduced=False)[1]
    name = f"The region {x0},{y0},{x1},{y1} of {path}"
    if x0 >= x1 or y0 >= y1:
        raise StyleSplatError(f"{name} is empty. Pass x0,y0,x1,y1 with x0 < x1 and y0 < y1.")
    if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
        raise StyleSplatError(f"{name} reaches outside. Stay within 0,0,{width},{height}.")
    _refuse_small(x1 - x0, y1 - y0, name)
    shrunk = round(width / pixels.shape[1])  # 2 for the largest JPEGs
    return pixels[y0 // shrunk : -(-y1 // shrunk), x0 // shrunk : -(-x1 // shrunk)]


def _shrink(pixels: UInt8[np.ndarray, "H W 3"], path: Path) -> UInt8[np.ndarray, "_ _ 3"]:
    height, width = pixels.shape[:2]
    factor = MAX_SIDE / max(width, height)
    if factor >= 1:
        return pixels
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    _refuse_small(*size, f"Scaled down to {MAX_SIDE} pixels of length, {path}")
    say(f"{path}: scaled down from {width}x{height} to {size[0]}x{size[1]} pixels")
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def _turn(
    pixels: UInt8[np.ndarray, "H W 3"], degrees: float, path: Path
) -> UInt8[np.ndarray, "_ _ 3"]:
    if degrees % 90 == 0:
        return np.rot90(pixels, int(degrees // 90) % 4)
    height, width = pixels.shape[:2]
    inner_width, inner_height = (int(s) for s in inscribed_rectangle(width, height, degrees))
    _refuse_small(inner_width, inner_height, f"Turned by {degrees}, what is left of {path}")
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    back = np.array([[cos, -sin], [sin, cos]])  # y points down
    # Centres of pixels lie at +0.5
    center = np.array([width - 1, height - 1]) / 2
    inner_center = np.array([inner_width - 1, inner_height - 1]) / 2
    T_to_source = np.column_stack([back, center - back @ inner_center])
    return cv2.warpAffine(
        np.ascontiguousarray(pixels),
        T_to_source,
        (inner_width, inner_height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )

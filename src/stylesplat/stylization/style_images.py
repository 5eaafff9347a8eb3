"""Style pictures, from files or tensors: upright, of a sensible size, cropped and turned."""

import math
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.images import image_sizes, open_image, read_image
from stylesplat.progress import say

MIN_SIDE = 32  # pixels; in less is no texture: one feature of VGG's block 3 sees 40
MAX_SIDE = 4096  # pixels; styles are resized to some hundred, so more is memory only


Picture = Path | str | Float[Tensor, "_ _ 3"] | UInt8[Tensor, "_ _ 3"]
"""A file, or colours: floats in 0..1, or bytes."""
Pixels = UInt8[np.ndarray, "_ _ 3"] | Float[np.ndarray, "_ _ 3"]


def read_style(
    picture: Picture, *, rotate: float = 0.0, region: tuple[int, int, int, int] | None = None
) -> Float[Tensor, "_ _ 3"]:
    """Read a picture to take a style from.

    Longer sides than 4096 pixels are scaled down, which the user is told.

    Args:
        picture: A file with one frame, of JPEG, PNG, TIFF, WebP, AVIF, BMP, GIF, PPM or TGA; or
            colours.
        rotate: Degrees counter-clockwise; of what is turned, the largest upright rectangle
            without empty corners is kept. Multiples of 90 keep every pixel as it is.
        region: x0, y0, x1, y1 to crop to before all else, in pixels of the upright picture.

    Returns:
        Colours in 0..1.

    Raises:
        StyleSplatError: If the file is no picture or animated, colours are out of range, the
            region does not lie in it, or less than 32 pixels remain of a side.
    """
    name = "the tensor" if isinstance(picture, Tensor) else str(picture)
    if not math.isfinite(rotate):
        raise StyleSplatError(f"Cannot turn {name} by {rotate} degrees. Pass a number of degrees.")
    if isinstance(picture, Tensor):
        pixels = _colors_of(picture)
    else:
        _refuse_unfit(Path(picture))
        pixels = read_image(Path(picture)).numpy()
    if region is not None:
        height, width = pixels.shape[:2]
        if not isinstance(picture, Tensor):
            width, height = image_sizes(Path(picture), reduced=False)[1]
        pixels = _crop(pixels, region, (width, height), name)
    pixels = _shrink(pixels, name)
    colors = torch.from_numpy(np.ascontiguousarray(_turn(pixels, rotate, name)))
    return colors.float() / 255 if colors.dtype == torch.uint8 else colors.clamp(0, 1)


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
    with open_image(path) as image:
        frames, size = getattr(image, "n_frames", 1), image.size
    if frames > 1:
        raise StyleSplatError(
            f"The picture {path} has {frames} frames (an animation or several pages). "
            "Save one frame as a picture of its own."
        )
    _refuse_small(*size, f"The picture {path}")


def _colors_of(tensor: Tensor) -> Pixels:
    """The colours of a tensor, checked: bytes, or floats in 0..1."""
    if tensor.ndim != 3 or tensor.shape[2] != 3:
        raise StyleSplatError(
            f"A style tensor has the shape [H, W, 3], this one has {[*tensor.shape]}. Move its "
            "colour channels to the end."
        )
    _refuse_small(tensor.shape[1], tensor.shape[0], "The style tensor")
    if tensor.dtype == torch.uint8:
        return tensor.cpu().numpy()
    colors = tensor.detach().to("cpu", torch.float32)
    if not (tensor.is_floating_point() and colors.isfinite().all()):
        raise StyleSplatError(
            f"A style tensor holds finite floats in 0..1 or bytes, this one has {tensor.dtype} "
            "and may hold NaN or infinity. Pass its colours in 0..1."
        )
    low, high = float(colors.min()), float(colors.max())
    if low < 0 or high > 1:
        raise StyleSplatError(
            f"A style tensor holds floats in 0..1, this one reaches from {low:g} to {high:g}. "
            "Divide it by 255, clamp it, or pass bytes."
        )
    return colors.numpy()


def _refuse_small(width: int, height: int, what: str) -> None:
    if min(width, height) < MIN_SIDE:
        raise StyleSplatError(
            f"{what} is {width}x{height} pixels, too little to take a style from. "
            f"Use at least {MIN_SIDE}x{MIN_SIDE}."
        )


def _crop(
    pixels: Pixels, region: tuple[int, int, int, int], size: tuple[int, int], name: str
) -> Pixels:
    x0, y0, x1, y1 = region
    width, height = size
    name = f"The region {x0},{y0},{x1},{y1} of {name}"
    if x0 >= x1 or y0 >= y1:
        raise StyleSplatError(f"{name} is empty. Pass x0,y0,x1,y1 with x0 < x1 and y0 < y1.")
    if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
        raise StyleSplatError(f"{name} reaches outside. Stay within 0,0,{width},{height}.")
    _refuse_small(x1 - x0, y1 - y0, name)
    shrunk = round(width / pixels.shape[1])  # 2 for the largest JPEGs
    return pixels[y0 // shrunk : -(-y1 // shrunk), x0 // shrunk : -(-x1 // shrunk)]


def _shrink(pixels: Pixels, name: str) -> Pixels:
    height, width = pixels.shape[:2]
    factor = MAX_SIDE / max(width, height)
    if factor >= 1:
        return pixels
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    _refuse_small(*size, f"Scaled down to {MAX_SIDE} pixels of length, {name}")
    say(f"{name}: scaled down from {width}x{height} to {size[0]}x{size[1]} pixels")
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def _turn(pixels: Pixels, degrees: float, name: str) -> Pixels:
    if degrees % 90 == 0:
        return np.rot90(pixels, int(degrees // 90) % 4)
    height, width = pixels.shape[:2]
    inner_width, inner_height = (int(s) for s in inscribed_rectangle(width, height, degrees))
    _refuse_small(inner_width, inner_height, f"Turned by {degrees}, what is left of {name}")
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

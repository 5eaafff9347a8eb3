"""Photos on disk, as the pinhole cameras of a capture see them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from PIL import ExifTags, Image
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.decoding import MAX_PIXELS, exif_of, in_bands, opened, reading
from stylesplat.io.captures.lens import Lens, bands

UPRIGHT = 1  # EXIF's orientation of a photo to be shown as it is stored
MAX_GREY = 0xFFFF  # Pillow's mode I is of 32 bits, but holds 16-bit grey of PGM files too
OPAQUE = 128  # the alpha from which a pixel shows something
BLACK, WHITE = 0, 255
# What shows a picture upright, by EXIF orientation
TURNS: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    2: np.fliplr,
    3: partial(np.rot90, k=2),
    4: np.flipud,
    5: lambda pixels: pixels.swapaxes(0, 1),
    6: partial(np.rot90, k=-1),
    7: lambda pixels: np.rot90(pixels, k=2).swapaxes(0, 1),
    8: np.rot90,
}
QUARTER_TURNS = (5, 6, 7, 8)  # EXIF orientations that exchange width and height


def read_image(path: Path | str) -> UInt8[Tensor, "H W 3"]:
    """Read a picture upright, as sRGB.

    The EXIF rotation is applied, transparency shows white, grey becomes RGB and of 16 bits the
    upper 8 are taken.

    Raises:
        StyleSplatError: If there is no such file or it is no readable picture.
    """
    with reading(Path(path)):
        pixels = _over(WHITE, _decode(Path(path), upright=True))
        return torch.from_numpy(np.ascontiguousarray(pixels[..., :3]))


@dataclass(frozen=True)
class Photo:
    """One photo of a capture: where it lies and what to do with it."""

    path: Path
    """The file."""
    upright: bool
    """Whether its EXIF rotation applies; some poses were found without it."""
    lens: Lens
    """What it was taken with, in the file's pixels."""
    size: tuple[int, int]
    """Width and height to give it once undistorted."""

    def read(self) -> UInt8[Tensor, "H W 3"]:
        """Read, rotate, undistort and shrink (every pixel then averages what it covers).

        Transparency shows black.

        Raises:
            StyleSplatError: If the file is no longer readable.
        """
        return self.read_with_alpha()[..., :3].contiguous()

    def read_with_alpha(self) -> UInt8[Tensor, "H W D"]:
        """The same, with alpha as a fourth channel if the file has transparency.

        Raises:
            StyleSplatError: If the file is no longer readable.
        """
        with reading(self.path):
            # Over black: averages of such pixels are free of the colours that nobody sees
            pixels = _over(BLACK, _decode(self.path, upright=self.upright))
            pixels = self.lens.undistort(pixels)
            if pixels.shape[1::-1] != self.size:
                pixels = cv2.resize(pixels, self.size, interpolation=cv2.INTER_AREA)
            return torch.from_numpy(pixels)

    def is_cut_out(self) -> bool:
        """Whether the file has transparent pixels; looks for them only if it may have some.

        Raises:
            StyleSplatError: If the file is no longer readable.
        """
        return self.has_alpha() and bool(
            (_decode(self.path, upright=self.upright)[:, :, 3:] < OPAQUE).any()
        )

    def has_alpha(self) -> bool:
        """Whether the file has transparency, be it opaque everywhere; reads its header.

        Raises:
            StyleSplatError: If the file is no longer readable.
        """
        with opened(self.path) as image:
            return image.has_transparency_data

    def resized(self, width: int, height: int) -> "Photo":
        """The same photo, to be given another size."""
        return replace(self, size=(width, height))


@dataclass(frozen=True)
class SmallPhoto:
    """What is seen of a photo at a glance."""

    grey: UInt8[np.ndarray, "h w"]
    """Upright, over white."""
    size: tuple[int, int]
    """Width and height of the whole, upright."""
    transparent: float
    """The share of pixels that show nothing."""


def read_small(path: Path, side: int) -> SmallPhoto:
    """Read a photo upright in grey, with a longer side of so many pixels or fewer.

    Raises:
        StyleSplatError: If there is no such file or it is no readable picture.
    """
    with opened(path) as image:
        size, orientation = image.size, _orientation(image)
        scale = side / max(size)
        if image.format == "JPEG" and scale < 1:  # decoded at a part of its size, which is fast
            image.draft("L", (round(size[0] * scale), round(size[1] * scale)))
        pixels = in_bands(image, _pixels)
        transparent = float((pixels[..., 3:] < OPAQUE).mean()) if pixels.shape[2] > 3 else 0.0
        grey = cv2.cvtColor(_over(WHITE, pixels)[..., :3], cv2.COLOR_RGB2GRAY)
    if scale < 1:
        small = tuple(max(1, round(length * scale)) for length in size)
        grey = cv2.resize(grey, small, interpolation=cv2.INTER_AREA)
    upright = (size[1], size[0]) if orientation in QUARTER_TURNS else size
    turn = TURNS.get(orientation, np.ascontiguousarray)
    return SmallPhoto(np.ascontiguousarray(turn(grey)), upright, transparent)


def plain_suffix(path: Path) -> str | None:
    """`.jpg` or `.png` for an upright, opaque picture of such a kind in 8-bit RGB, else None.

    Raises:
        StyleSplatError: If the file is missing or no picture.
    """
    with opened(path, reduced=False) as image:
        suffix = {"JPEG": ".jpg", "PNG": ".png"}.get(image.format or "")
        deep = any("16" in str(tile.args) for tile in getattr(image, "tile", ()))
        simple = image.mode == "RGB" and not image.has_transparency_data and not deep
        fits = image.width * image.height <= MAX_PIXELS
        return suffix if simple and fits and _orientation(image) == UPRIGHT else None


def fit_photo(path: Path, lens: Lens) -> Photo:
    """Find how a photo and its camera go together, without decoding the photo.

    Upright is preferred to as stored, and the camera's exact size to a multiple of it; for a
    multiple, as in `images_2`, the camera is scaled.

    Raises:
        StyleSplatError: If the file is missing or no picture, or its shape is not the camera's.
    """
    stored, upright = photo_sizes(path)
    choices = ((upright, True), (stored, False))
    fits = [c for c in choices if c[0] == lens.size]
    fits += [c for c in choices if same_shape(c[0], lens.size)]
    if not fits:
        raise StyleSplatError(
            f"The photo {path} is {upright[0]}x{upright[1]}, which is no multiple of its camera's "
            f"{lens.width}x{lens.height}. Put back the photos that were posed."
        )
    size, is_upright = fits[0]
    lens = lens if size == lens.size else lens.scaled(*size)
    return Photo(path, is_upright, lens, lens.pinhole().size)


def photo_sizes(path: Path, *, reduced: bool = True) -> tuple[tuple[int, int], tuple[int, int]]:
    """Width and height as stored, and after the EXIF rotation, from the file's header.

    Args:
        path: The file.
        reduced: False for those in the file, be they more than what is decoded.

    Raises:
        StyleSplatError: If the file is missing or no picture.
    """
    with opened(path, reduced=reduced) as image:
        turned = _orientation(image) in QUARTER_TURNS
        width, height = image.size
        return (width, height), (height, width) if turned else (width, height)


def is_reduced(path: Path) -> bool:
    """Whether a file has so many pixels that it is read at half its width and height.

    Raises:
        StyleSplatError: If the file is missing or no picture.
    """
    return photo_sizes(path) != photo_sizes(path, reduced=False)


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one is a multiple of the other, but for rounding either side to a whole pixel."""
    return abs(size[0] * other[1] - size[1] * other[0]) <= max(other)


def _decode(path: Path, *, upright: bool) -> UInt8[np.ndarray, "H W D"]:
    """RGB, or RGBA where the file has transparency."""
    with opened(path) as image:
        turn = TURNS.get(_orientation(image)) if upright else None
        pixels = in_bands(image, _pixels)
    return np.ascontiguousarray(turn(pixels)) if turn else pixels


def _orientation(image: Image.Image) -> int:
    return exif_of(image).get(ExifTags.Base.Orientation, UPRIGHT)


def _pixels(image: Image.Image) -> UInt8[np.ndarray, "H W D"]:
    if image.mode == "F":
        raise ValueError("its pixels are floating-point numbers")
    if image.mode.startswith("I"):  # 16-bit grey, which convert("RGB") would clip
        deep = np.asarray(image)
        if deep.min() < 0 or deep.max() > MAX_GREY:
            raise ValueError("its pixels do not fit into 16 bits")
        grey = (deep >> 8).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    return np.array(image.convert("RGBA" if image.has_transparency_data else "RGB"))


def _over(behind: int, pixels: UInt8[np.ndarray, "H W D"]) -> UInt8[np.ndarray, "H W D"]:
    """The same pixels, in place, before a grey level where they are transparent."""
    if pixels.shape[2] == 3:
        return pixels
    for rows in bands(*pixels.shape[1::-1]):
        colors, alpha = pixels[rows, :, :3].astype(np.uint16), pixels[rows, :, 3:].astype(np.uint16)
        pixels[rows, :, :3] = (colors * alpha + behind * (255 - alpha) + 127) // 255
    return pixels

"""Photos on disk, as the pinhole cameras of a capture see them, and which pixels may be used."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import Lens
from stylesplat.io.images import (
    QUARTER_TURNS,
    TURNS,
    UPRIGHT,
    WHITE,
    decode,
    decoding,
    flatten_alpha,
    image_sizes,
    open_image,
    orientation,
    pixels_of,
)
from stylesplat.io.mask_pictures import LOSSY, MASK_HALF
from stylesplat.photo_libraries import cv2
from stylesplat.progress import say, track
from stylesplat.scene.capture import resize_labels, shrink_mask
from stylesplat.scene.sequences import Lazy

PHOTO_OPAQUE = 128  # smallest alpha of a pixel that shows something
BLACK = 0


@dataclass(frozen=True)
class Photo:
    """One photo of a capture: its file, its lens and the size it is wanted at."""

    path: Path
    upright: bool
    """Whether its EXIF rotation applies: poses belong to the pixels as stored, few to these."""
    lens: Lens
    """The lens, in pixels of the file."""
    size: tuple[int, int]
    """Width and height of the undistorted photo."""
    as_stored: bool = False
    """Whether it has an EXIF rotation which does not apply."""
    taken: Lens | None = None
    """The lens with which it was taken, where the file is undistorted already and that is known."""

    def read(self) -> UInt8[Tensor, "H W 3"]:
        """Decode, rotate, undistort and shrink (by area averages); transparency becomes black."""
        return self.read_with_alpha()[..., :3].contiguous()

    def read_with_alpha(self) -> UInt8[Tensor, "H W D"]:
        """The same, with alpha as a fourth channel if the file has transparency."""
        with decoding(self.path):
            # Over black, so that averages are free of colours that nobody sees
            pixels = flatten_alpha(decode(self.path, upright=self.upright), BLACK)
            pixels = self.lens.undistort(pixels)
            if pixels.shape[1::-1] != self.size:
                pixels = cv2.resize(pixels, self.size, interpolation=cv2.INTER_AREA)
            return torch.from_numpy(pixels)

    def is_cut_out(self) -> bool:
        """Whether the file has transparent pixels; decodes it only if it has an alpha channel."""
        return self.has_alpha() and bool(
            (decode(self.path, upright=self.upright)[:, :, 3:] < PHOTO_OPAQUE).any()
        )

    def has_alpha(self) -> bool:
        """Whether the file has an alpha channel, from its header."""
        with open_image(self.path) as image:
            return image.has_transparency_data

    def resized(self, width: int, height: int) -> "Photo":
        return replace(self, size=(width, height))


def fit_photo(path: Path, lens: Lens) -> Photo:
    """Match a photo with its camera, from the header of the file.

    Poses belong to the pixels as stored, unless their size fits only the photo that the EXIF
    rotation makes upright. The camera's exact size is preferred to a multiple of it; for a
    multiple, as in `images_2`, the camera is scaled. Raises a StyleSplatError if the shapes differ.
    """
    with open_image(path) as image:
        stored, turned = image.size, orientation(image)
    upright = (stored[1], stored[0]) if turned in QUARTER_TURNS else stored
    choices = ((stored, False), (upright, True))
    fits = [c for c in choices if c[0] == lens.size]
    fits += [c for c in choices if same_shape(c[0], lens.size)]
    if not fits:
        raise StyleSplatError(
            f"The photo {path} is {stored[0]}x{stored[1]}, which is no multiple of its camera's "
            f"{lens.width}x{lens.height}. Put back the photos that were posed."
        )
    size, is_upright = fits[0]
    lens = lens if size == lens.size else lens.scaled(*size)
    as_stored = turned in TURNS and not is_upright
    return Photo(path, is_upright, lens, lens.pinhole().size, as_stored)


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one size is a multiple of the other, each side rounded to a whole pixel."""
    return abs(size[0] * other[1] - size[1] * other[0]) <= max(other)


@dataclass(frozen=True, eq=False)
class SmallPhoto:
    grey: UInt8[np.ndarray, "h w"]
    """Upright, over white."""
    size: tuple[int, int]
    """Width and height of the full photo, upright."""
    transparent: float
    """Share of transparent pixels."""


def read_small(path: Path, side: int) -> SmallPhoto:
    """Read a photo upright in grey, its longer side `side` pixels at most."""
    with open_image(path) as image:
        size, turned = image.size, orientation(image)
        scale = side / max(size)
        if image.format == "JPEG" and scale < 1:  # decoded at a fraction of its size, which is fast
            image.draft("L", (round(size[0] * scale), round(size[1] * scale)))
        pixels = pixels_of(image)
        transparent = float((pixels[..., 3:] < PHOTO_OPAQUE).mean()) if pixels.shape[2] > 3 else 0.0
        grey = cv2.cvtColor(flatten_alpha(pixels, WHITE)[..., :3], cv2.COLOR_RGB2GRAY)
    if scale < 1:
        small = tuple(max(1, round(length * scale)) for length in size)
        grey = cv2.resize(grey, small, interpolation=cv2.INTER_AREA)
    upright = (size[1], size[0]) if turned in QUARTER_TURNS else size
    turn = TURNS.get(turned, np.ascontiguousarray)
    return SmallPhoto(np.ascontiguousarray(turn(grey)), upright, transparent)


def plain_suffix(path: Path) -> str | None:
    """`.jpg` or `.png` for an upright, opaque picture in 8-bit RGB of that kind, else None."""
    with open_image(path) as image:
        suffix = {"JPEG": ".jpg", "PNG": ".png"}.get(image.format or "")
        deep = any("16" in str(tile.args) for tile in getattr(image, "tile", ()))
        simple = image.mode == "RGB" and not image.has_transparency_data and not deep
        return suffix if simple and orientation(image) == UPRIGHT else None


def valid_pixels(
    masks: Sequence[Path | None], photos: Sequence[Photo]
) -> Lazy[Bool[Tensor, "H W"] | None]:
    """The pixels of each photo that may be used, read on access; None where all may."""
    pairs = zip(masks, photos, strict=True)
    return Lazy([partial(read_valid, *pair) if pair[0] else lambda: None for pair in pairs])


def read_valid(path: Path, photo: Photo) -> Bool[Tensor, "H W"]:
    """Read a mask at the photo's size: valid pixels, to which no masked one contributes."""
    used = resize_labels(_read(path), photo.lens.size[::-1])
    pixels = photo.lens.undistort(255 * used.to(torch.uint8).numpy())
    return shrink_mask(torch.from_numpy(pixels == 255), photo.size[::-1])


def check_masks(masks: Sequence[Path | None], photos: Sequence[Photo]) -> None:
    """Check the masks' shapes, and say in a line how much they leave out."""
    shares = list[float]()
    pairs = [(path, photo) for path, photo in zip(masks, photos, strict=True) if path]
    for path, photo in track(pairs, "reading masks", unit="photo"):
        size = image_sizes(path)[0]
        if not same_shape(size, photo.lens.size):
            raise StyleSplatError(
                f"The mask {path} is {size[0]}x{size[1]}, which is not the shape of its photo "
                f"({photo.lens.width}x{photo.lens.height}). Make it from that photo."
            )
        shares.append(1 - float(_read(path).float().mean()))
    if not pairs:
        return
    say(
        f"{len(pairs)} of {len(photos)} photos have a mask (mask_path). Pixels where it is 0, "
        f"{100 * sum(shares) / len(shares):.0f} % of theirs, are neither trained on nor measured."
    )


def _read(path: Path) -> Bool[Tensor, "H W"]:
    """Where a mask is not 0: its alpha channel if that varies, else its colours or grey."""
    with open_image(path) as image:
        least = MASK_HALF if image.format in LOSSY else 1  # whose black is not exactly 0
        if image.has_transparency_data:
            alpha = np.asarray(image.convert("RGBA"))[..., 3]
            if alpha.min() != alpha.max():
                return torch.from_numpy(alpha >= least)
        if image.mode in ("P", "PA", "CMYK", "YCbCr", "LAB", "HSV"):
            image = image.convert("RGB")
        pixels = np.asarray(image)
        bands = len(image.getbands())
        colors = pixels[..., :3] if bands >= 3 else pixels.reshape(*pixels.shape[:2], -1)[..., :1]
        return torch.from_numpy((colors >= least).any(axis=-1))

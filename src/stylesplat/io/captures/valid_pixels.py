"""Which pixels of a photo may be used: the masks that frames of transforms.json name."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.photos import Photo, same_shape
from stylesplat.io.images import image_sizes, open_image
from stylesplat.io.mask_pictures import HALF, LOSSY
from stylesplat.progress import say, track
from stylesplat.scene.cache import Lazy
from stylesplat.scene.labels import resize_labels, shrink_mask


def valid_pixels(
    masks: Sequence[Path | None], photos: Sequence[Photo]
) -> Lazy[Bool[Tensor, "H W"] | None]:
    """The pixels of each photo that may be used, read on access; None where all may."""
    pairs = zip(masks, photos, strict=True)
    return Lazy([partial(read_valid, *pair) if pair[0] else lambda: None for pair in pairs])


def read_valid(path: Path, photo: Photo) -> Bool[Tensor, "H W"]:
    """Read a mask undistorted, at the photo's size.

    A pixel is valid if no masked one contributes to it, since photos are interpolated and averaged.
    """
    used = resize_labels(_read(path), photo.lens.size[::-1])
    pixels = photo.lens.undistort(255 * used.to(torch.uint8).numpy())
    return shrink_mask(torch.from_numpy(pixels == 255), photo.size[::-1])


def check_masks(masks: Sequence[Path | None], photos: Sequence[Photo]) -> None:
    """Check the masks' shapes, and say in a line how much they leave out.

    Raises a StyleSplatError for a mask of another shape than its photo's, or no picture.
    """
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
        least = HALF if image.format in LOSSY else 1  # whose black is not exactly 0
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

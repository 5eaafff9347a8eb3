"""Photos as structure from motion gets them: upright, in JPEG or PNG, with their focal length."""

import shutil
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from stylesplat.io.atomic import atomic_path
from stylesplat.io.captures.photos import plain_suffix
from stylesplat.io.images import QUALITY, open_image, read_image
from stylesplat.structure_from_motion.exif import lens_exif


def write_photo(source: Path, target: Path) -> None:
    """Copy a photo if that serves, else write it decoded and upright as JPEG.

    Raises:
        StyleSplatError: If the photo is unreadable, the disk is full or the place cannot be
            written to.
    """
    if plain_suffix(source):
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
        return
    pixels, profile = read_image(source).numpy(), color_profile(source)
    write_jpeg(pixels, target, exif=lens_exif(source), icc_profile=profile)


def color_profile(path: Path) -> bytes | None:
    """The ICC profile that the colours of an RGB picture are to be read by, if it has one.

    Raises:
        StyleSplatError: If there is no such file or it is no picture.
    """
    with open_image(path, reduced=False) as image:
        return image.info.get("icc_profile") if image.mode in ("RGB", "RGBA") else None


def write_jpeg(
    pixels: UInt8[np.ndarray, "H W 3"],
    target: Path,
    *,
    exif: bytes = b"",
    icc_profile: bytes | None = None,
) -> None:
    """Write a picture of high quality.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    with atomic_path(target) as temporary:
        Image.fromarray(pixels).save(
            temporary, "JPEG", quality=QUALITY, subsampling=0, exif=exif, icc_profile=icc_profile
        )

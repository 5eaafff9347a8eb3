"""What a photo's EXIF data tell of its lens and its time."""

import math
from pathlib import Path

from PIL import ExifTags, Image

from stylesplat.io.captures.decoding import opened

Base = ExifTags.Base
# What COLMAP finds a focal length by, and what identifies the camera. Places are left behind
CAMERA = (Base.Make, Base.Model)
LENS = (
    *(Base.FocalLength, Base.FocalLengthIn35mmFilm, Base.FocalPlaneXResolution),
    *(Base.FocalPlaneYResolution, Base.FocalPlaneResolutionUnit, Base.LensModel),
)
TAKEN = (Base.DateTimeOriginal, Base.SubsecTimeOriginal)
LONGEST = 64  # characters of a camera's name or a time


def lens_exif(path: Path) -> bytes:
    """EXIF data with the camera, its lens and the time, without rotation; empty if unknown.

    Raises:
        StyleSplatError: If there is no such file or it is no readable picture.
    """
    with opened(path) as image:
        found, kept = image.getexif(), Image.Exif()
        of_lens = found.get_ifd(ExifTags.IFD.Exif)
        for tag in CAMERA:
            if _is_sane(found.get(tag)):
                kept[tag] = found[tag]
        lens = kept.get_ifd(ExifTags.IFD.Exif)
        for tag in (*LENS, *TAKEN):
            if _is_sane(of_lens.get(tag)):
                lens[tag] = of_lens[tag]
        return kept.tobytes() if kept or lens else b""


def taken_at(path: Path) -> str | None:
    """When a photo was taken, such that times sort as text; None if that is not known.

    Raises:
        StyleSplatError: If there is no such file or it is no picture.
    """
    with opened(path) as image:
        if image.format == "PNG" and "exif" not in image.info:  # to look, Pillow decodes it all
            return None
        found = image.getexif().get_ifd(ExifTags.IFD.Exif)
        day, part = (found.get(tag) for tag in TAKEN)
        if not isinstance(day, str) or not day[:4].isdigit():
            return None
        return f"{day[:LONGEST]}.{part}" if isinstance(part, str) else day[:LONGEST]


def _is_sane(value: object) -> bool:
    if isinstance(value, str):
        return 0 < len(value) <= LONGEST and value.isascii() and value.isprintable()
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return False
    return math.isfinite(number) and number > 0

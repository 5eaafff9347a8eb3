"""What a photo's EXIF data tell of its lens and its time."""

from pathlib import Path

from PIL import ExifTags, Image

from stylesplat.io.images import exif_of, open_image

Base = ExifTags.Base
# What COLMAP finds a focal length by, and what identifies the camera. Places are left behind
CAMERA = (Base.Make, Base.Model)
LENS = (
    *(Base.FocalLength, Base.FocalLengthIn35mmFilm, Base.FocalPlaneXResolution),
    *(Base.FocalPlaneYResolution, Base.FocalPlaneResolutionUnit, Base.LensModel),
)
TAKEN = (Base.DateTimeOriginal, Base.SubsecTimeOriginal)
LONGEST = 64  # characters of a camera's name or a time
MOST = 1e6  # millimetres or pixels in an inch: no camera has so many, and few formats hold all


def lens_exif(path: Path) -> bytes:
    """EXIF data with the camera, its lens and the time, without rotation.

    They are empty if unknown, or damaged: the photo itself may be whole.

    Raises:
        StyleSplatError: If there is no such file or it is no readable picture.
    """
    with open_image(path) as image:
        try:
            return _of_lens(exif_of(image))
        except Exception:  # Pillow raises all kinds
            return b""


def taken_at(path: Path) -> str | None:
    """When a photo was taken, such that times sort as text; None if that is not known.

    Raises:
        StyleSplatError: If there is no such file or it is no picture.
    """
    with open_image(path) as image:
        found = exif_of(image).get_ifd(ExifTags.IFD.Exif)
        day, part = (found.get(tag) for tag in TAKEN)
        if not isinstance(day, str) or not day[:4].isdigit():
            return None
        return f"{day[:LONGEST]}.{part}" if isinstance(part, str) else day[:LONGEST]


def _of_lens(found: Image.Exif) -> bytes:
    kept, more = Image.Exif(), found.get_ifd(ExifTags.IFD.Exif)
    for tag in CAMERA:
        if _is_sane(found.get(tag)):
            kept[tag] = found[tag]
    lens = kept.get_ifd(ExifTags.IFD.Exif)
    for tag in (*LENS, *TAKEN):
        if _is_sane(more.get(tag)):
            lens[tag] = more[tag]
    return kept.tobytes() if kept or lens else b""


def _is_sane(value: object) -> bool:
    if isinstance(value, str):
        return 0 < len(value) <= LONGEST and value.isascii() and value.isprintable()
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return False
    return 0 < number <= MOST

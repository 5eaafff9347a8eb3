"""Photo files: their EXIF data, which share a camera, and how they are written."""

import shutil
import warnings
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from PIL import ExifTags, Image

from stylesplat.io.atomic import atomic_path
from stylesplat.io.captures.photos import plain_suffix
from stylesplat.io.files import inside
from stylesplat.io.images import exif_of, open_image, read_image, write_image
from stylesplat.progress import track

T = TypeVar("T")
Result = TypeVar("Result")

DECODERS = 2  # threads; each needs 100 MB for a photo of 12 megapixels

Base = ExifTags.Base
# Tags that COLMAP reads the focal length from, and that identify the camera. GPS tags are dropped
CAMERA_TAGS = (Base.Make, Base.Model)
LENS_TAGS = (Base.FocalLength, Base.FocalLengthIn35mmFilm, Base.LensModel)
SENSOR_TAGS = (
    *(Base.FocalPlaneXResolution, Base.FocalPlaneYResolution, Base.FocalPlaneResolutionUnit),
)
MAX_TEXT = 64  # characters of a camera's name
MAX_NUMBER = 1e6  # millimetres or pixels in an inch: no camera has as many

# Photos of one camera that OPENCV's two focal lengths and four distortion coefficients need; with
# fewer, one of each is found. On desk, whose pixels are not square, OPENCV is three times as exact
MIN_FOR_OPENCV = 10


@dataclass(frozen=True)
class CameraGroup:
    rows: tuple[int, ...]

    @property
    def model(self) -> str:
        """COLMAP's name of the camera model to fit."""
        return "OPENCV" if len(self.rows) >= MIN_FOR_OPENCV else "SIMPLE_RADIAL"


def group_by_camera(photos: Path, names: Sequence[str], cameras: str) -> tuple[CameraGroup, ...]:
    """Group photos by size and lens, reading headers only."""
    rows: dict[tuple[object, ...], list[int]] = {}
    for row, name in enumerate(names):
        with open_image(inside(photos, name)) as image:
            key: tuple[object, ...] = image.size
            if cameras == "several":
                key = (row,)
            elif cameras == "auto":
                exif = exif_of(image)
                details = exif.get_ifd(ExifTags.IFD.Exif)
                lens = (str(details.get(tag)) for tag in LENS_TAGS)
                key = (*key, str(exif.get(Base.Model)), *lens)
        rows.setdefault(key, []).append(row)
    return tuple(CameraGroup(tuple(found)) for found in rows.values())


def lens_exif(path: Path) -> bytes:
    """EXIF data with the camera and its lens, without rotation and position.

    They are empty if unknown or damaged: the photo itself may be whole.
    """
    with open_image(path) as image:
        try:
            found, kept = exif_of(image), Image.Exif()
            details, kept_details = (e.get_ifd(ExifTags.IFD.Exif) for e in (found, kept))
            kept.update({t: found[t] for t in CAMERA_TAGS if _is_plausible(found.get(t))})
            tags = (*LENS_TAGS, *SENSOR_TAGS)
            kept_details.update({t: details[t] for t in tags if _is_plausible(details.get(t))})
            return kept.tobytes() if kept or kept_details else b""
        except Exception:  # Pillow raises all kinds
            return b""


def _is_plausible(value: object) -> bool:
    if isinstance(value, str):
        return 0 < len(value) <= MAX_TEXT and value.isascii() and value.isprintable()
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return False
    return 0 < number <= MAX_NUMBER


def color_profile(path: Path) -> bytes | None:
    with open_image(path) as image:
        return image.info.get("icc_profile") if image.mode in ("RGB", "RGBA") else None


def write_photo(source: Path, target: Path) -> None:
    """Copy an upright 8-bit JPEG or PNG; write any other photo upright as JPEG."""
    if plain_suffix(source):
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
        return
    exif, profile = lens_exif(source), color_profile(source)
    write_image(read_image(source), target, exif=exif, icc_profile=profile)


def map_photos(
    work: Callable[[T], Result], items: Collection[T], what: str, *, threads: int = DECODERS
) -> list[Result]:
    """Apply a function to photos in threads, with a progress bar; results are in order."""
    # Warning filters belong to the process: threads that change them would mix them up
    with warnings.catch_warnings(action="ignore"), ThreadPoolExecutor(threads) as pool:
        try:
            return [*track(pool.map(work, items), what, total=len(items), unit="photo")]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise

"""Which photos were taken with one camera: of one size, and through the same lens."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags, Image

from stylesplat.io.files import inside
from stylesplat.io.images import exif_of, open_image

# Photos of one camera that hold OPENCV's two focal lengths and four numbers of distortion; of
# fewer one of each is found. On desk, whose pixels are not square, OPENCV is three times as exact
ENOUGH = 10
LENS_TAGS = (
    ExifTags.Base.FocalLength,
    ExifTags.Base.FocalLengthIn35mmFilm,
    ExifTags.Base.LensModel,
)


@dataclass(frozen=True)
class PhotoGroup:
    """Photos that share a camera."""

    rows: tuple[int, ...]
    """Their places in the list of all."""

    @property
    def model(self) -> str:
        """COLMAP's name of the camera model to fit."""
        return "OPENCV" if len(self.rows) >= ENOUGH else "SIMPLE_RADIAL"


def group_photos(photos: Path, names: Sequence[str], cameras: str) -> tuple[PhotoGroup, ...]:
    """Sort photos by camera, reading headers only.

    Args:
        photos: Their folder.
        names: Paths in it.
        cameras: `SfmConfig.cameras`.

    Raises:
        StyleSplatError: If a photo is no readable picture.
    """
    rows: dict[tuple[tuple[int, int], tuple[object, ...]], list[int]] = {}
    for row, name in enumerate(names):
        with open_image(inside(photos, name), reduced=False) as image:
            lens = (row,) if cameras == "several" else _lens(image) if cameras == "auto" else ()
            rows.setdefault((image.size, lens), []).append(row)
    return tuple(PhotoGroup(tuple(found)) for found in rows.values())


def _lens(image: Image.Image) -> tuple[str, ...]:
    """What EXIF data tell of the lens and its zoom."""
    exif = exif_of(image)
    more = exif.get_ifd(ExifTags.IFD.Exif)
    return str(exif.get(ExifTags.Base.Model)), *(str(more.get(tag)) for tag in LENS_TAGS)

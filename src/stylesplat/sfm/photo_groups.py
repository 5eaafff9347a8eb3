"""Which photos were taken with one camera: of one size, and through the same lens."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags, Image

from stylesplat.io.captures.decoding import opened
from stylesplat.io.files import inside

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

    size: tuple[int, int]
    """Width and height of each."""
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
    rows: dict[tuple[object, ...], list[int]] = {}
    for row, name in enumerate(names):
        with opened(inside(photos, name), reduced=False) as image:
            rows.setdefault(_key(image, row, cameras), []).append(row)
    return tuple(PhotoGroup((key[0], key[1]), tuple(found)) for key, found in rows.items())  # pyright: ignore[reportArgumentType]


def _key(image: Image.Image, row: int, cameras: str) -> tuple[object, ...]:
    if cameras == "several":
        return *image.size, row
    if cameras == "one":
        return image.size
    exif = image.getexif()
    lens = exif.get_ifd(ExifTags.IFD.Exif)
    seen = tuple(str(lens.get(tag)) for tag in LENS_TAGS)
    return *image.size, str(exif.get(ExifTags.Base.Model)), *seen

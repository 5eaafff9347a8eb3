"""The one way from a file to the pixels of a picture: files may come from strangers."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Shaped
from PIL import Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import bands
from stylesplat.io.files import reason, require_regular

# What Pillow decodes in itself or by libraries that everybody's browser has, and cameras write
FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "AVIF", "BMP", "DIB", "GIF", "PPM", "TGA")
# A photo takes up to 7 bytes a pixel while it is decoded, so less than 1 GiB; phones' 108 and
# medium format's 100 megapixels pass
MAX_PIXELS = 2**27
# For 200 megapixels of phones. JPEGs are decoded at half their sides at little cost, but those in
# several scans keep 6 bytes a pixel on the way: 1.5 GiB
MAX_JPEG_PIXELS = 2**28
MAX_BYTES = 2**30  # of a file, which some decoders read whole: more than any of so many pixels has
JPEG_START = b"\xff\xd8\xff"
HEIC_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx")  # in the box `ftyp`
FTYP_BYTES = 64  # of a file that tell its brands
NO_MEMORY = -4  # cv2.Error.StsNoMem


@contextmanager
def opened(path: Path, *, reduced: bool = True) -> Iterator[Image.Image]:
    """A picture whose header is read; whatever goes wrong with it in the block, the file is named.

    JPEGs of too many pixels have half the width and height.

    Args:
        path: A file of one of `FORMATS`, or HEIC where pillow-heif is installed.
        reduced: False to look at the size that such a JPEG has in its file.

    Raises:
        StyleSplatError: If there is no such file, or it is none of these, damaged or too large.
    """
    require_regular(path)
    # Pillow's warnings, of damaged EXIF data for example, tell users of StyleSplat nothing
    with reading(path), warnings.catch_warnings(action="ignore"), path.open("rb") as file:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError("it has more than 1 GiB")
        yield _open(file, path, reduced=reduced)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Make whatever the pixels of a file lead to a StyleSplatError; Pillow raises all kinds.

    Raises:
        StyleSplatError: If anything is raised within the block.
    """
    try:
        yield
    except StyleSplatError:
        raise
    except Exception as error:
        raise _unreadable(path, error) from error


def exif_of(image: Image.Image) -> Image.Exif:
    """EXIF data, of a PNG only if they precede the pixels: to look behind, Pillow decodes all."""
    if image.format == "PNG" and "exif" not in image.info:
        return Image.Exif()
    return image.getexif()


def in_bands(
    image: Image.Image, make: Callable[[Image.Image], Shaped[np.ndarray, "h W *D"]]
) -> Shaped[np.ndarray, "H W *D"]:
    """What is made of a picture's rows, some at a time, which saves the memory of copies."""
    image.load()
    width, height = image.size
    whole = None
    for rows in bands(width, height):
        piece = make(image.crop((0, rows.start, width, rows.stop)))
        if whole is None:
            whole = np.empty((height, *piece.shape[1:]), piece.dtype)
        whole[rows] = piece
    assert whole is not None
    return whole


def _open(file: BinaryIO, path: Path, *, reduced: bool) -> Image.Image:
    start = file.read(FTYP_BYTES)
    file.seek(0)
    if start.startswith(JPEG_START):  # not by `Image.open`, which has a bound of its own
        return _open_jpeg(JpegImageFile(file), path, reduced=reduced)
    try:
        image = _open_heic(file, path) if _is_heic(start) else Image.open(file, formats=FORMATS)
    except UnidentifiedImageError as error:
        raise ValueError(f"it is no picture, or none of {', '.join(FORMATS)}") from error
    except Image.DecompressionBombError as error:
        raise _too_large(path) from error
    if image.width * image.height > MAX_PIXELS:
        raise _too_large(path)
    return image


def _open_jpeg(image: JpegImageFile, path: Path, *, reduced: bool) -> Image.Image:
    pixels = image.width * image.height
    if pixels > MAX_JPEG_PIXELS:
        raise _too_large(path)
    if pixels > MAX_PIXELS and reduced:
        image.draft(None, (image.width // 2, image.height // 2))
        if image.width * image.height > MAX_PIXELS:
            raise _too_large(path)
    return image


def _is_heic(start: bytes) -> bool:
    brands = start[8 : int.from_bytes(start[:4])]
    return start[4:8] == b"ftyp" and any(brand in brands for brand in HEIC_BRANDS)


def _open_heic(file: BinaryIO, path: Path) -> Image.Image:
    """Upright: libheif turns it, whatever its EXIF data said."""
    try:
        from pillow_heif import HeifImageFile
    except ImportError as error:
        raise StyleSplatError(
            f"Cannot read {path}: it is HEIC. `pip install 'stylesplat[heic]'` makes it readable."
        ) from error
    return HeifImageFile(file)


def _too_large(path: Path) -> StyleSplatError:
    return StyleSplatError(
        f"The picture {path} has more than {MAX_PIXELS // 10**6} megapixels (JPEGs may have "
        f"{MAX_JPEG_PIXELS // 10**6}). Scale it to half its width and height."
    )


def _unreadable(path: Path, error: Exception) -> StyleSplatError:
    if isinstance(error, FileNotFoundError):
        return StyleSplatError(f"There is no image {path}. Check the name and the folder.")
    if isinstance(error, MemoryError) or getattr(error, "code", None) == NO_MEMORY:
        return StyleSplatError(
            f"There is not enough memory to read the image {path}. Scale the photos down."
        )
    return StyleSplatError(f"Cannot read the image {path}: {reason(error)}. Replace the file.")

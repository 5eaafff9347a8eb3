"""Pictures on disk: opened with care, since files may come from strangers, decoded, and written."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import reason, require_regular

# What Pillow decodes itself or by libraries that every browser has, and that cameras write
IMAGE_FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "AVIF", "BMP", "DIB", "GIF", "PPM", "TGA")
# Decoding takes up to 12 bytes a pixel, so 1.5 GiB; the 108 megapixels of phones and 100 of medium
# format cameras pass
IMAGE_MAX_PIXELS = 2**27
IMAGE_MAX_BYTES = 2**30  # of a file: some decoders read all of it, and no fitting picture has more
JPEG_START = b"\xff\xd8\xff"
HEIC_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx")  # in the box `ftyp`
FTYP_BYTES = 64  # at the start of a file, which hold its brands
IMAGE_NO_MEMORY = -4  # cv2.Error.StsNoMem
ROWS_PIXELS = 2**22  # of a band of rows, so that working copies take little memory
UPRIGHT = 1  # EXIF orientation of a photo that is stored as it is shown
# What turns stored pixels upright, by EXIF orientation
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
MAX_GREY = 0xFFFF  # Pillow's mode I has 32 bits, but it also holds 16-bit grey of PGM files
WHITE = 255
QUALITY = 95  # of JPEG, with colours at full resolution: losses are hardly visible
LOOK_QUALITY = 90  # of JPEG in pages and answers, where files are to be small
PNG_LEVEL = 4  # of 9: half the time of the usual 6, and files larger by a twentieth

ColorPicture = UInt8[Tensor, "H W 3"] | UInt8[Tensor, "H W 4"]
"""Colours, and perhaps straight (not premultiplied) alpha."""
ViewPicture = ColorPicture | Int[Tensor, "H W"] | Float[Tensor, "H W"]
"""Colours; label ids; or depths, in steps or in world units."""


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open a picture and read its header; any error in the block names the file."""
    require_regular(path)
    # Pillow warns of damaged EXIF data and the like, which the user cannot act on
    with decoding(path), warnings.catch_warnings(action="ignore"), path.open("rb") as file:
        if path.stat().st_size > IMAGE_MAX_BYTES:
            raise ValueError("it has more than 1 GiB")
        yield _open(file, path)


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Turn whatever decoding a file raises (Pillow raises all kinds) into a StyleSplatError."""
    try:
        yield
    except StyleSplatError:
        raise
    except FileNotFoundError as error:
        raise StyleSplatError(
            f"There is no image {path}. Check the name and the folder."
        ) from error
    except Exception as error:
        if isinstance(error, MemoryError) or getattr(error, "code", None) == IMAGE_NO_MEMORY:
            raise StyleSplatError(
                f"There is not enough memory to read the image {path}. Scale the photos down."
            ) from error
        raise StyleSplatError(
            f"Cannot read the image {path}: {reason(error)}. Replace the file."
        ) from error


def read_image(path: Path | str) -> UInt8[Tensor, "H W 3"]:
    """Read a picture upright, as 8-bit sRGB; transparency becomes white, grey becomes RGB."""
    with decoding(Path(path)):
        return on_white(decode(Path(path), upright=True))


def on_white(pixels: UInt8[np.ndarray, "H W D"]) -> UInt8[Tensor, "H W 3"]:
    """Put transparent pixels over white, in place; without alpha."""
    return torch.from_numpy(np.ascontiguousarray(flatten_alpha(pixels, WHITE)[..., :3]))


def decode(path: Path, *, upright: bool) -> UInt8[np.ndarray, "H W D"]:
    """The pixels of a picture as RGB, or as RGBA if the file has transparency."""
    with open_image(path) as image:
        turn = TURNS.get(orientation(image)) if upright else None
        pixels = pixels_of(image)
    return np.ascontiguousarray(turn(pixels)) if turn else pixels


def decode_embedded(content: bytes, path: Path) -> UInt8[np.ndarray, "H W 4"]:
    """The pixels of a picture within a file as RGBA."""
    with decoding(path), warnings.catch_warnings(action="ignore"):
        return np.array(_open(BytesIO(content), path).convert("RGBA"))


def image_sizes(path: Path) -> tuple[tuple[int, int], tuple[int, int]]:
    """Width and height as stored and after the EXIF rotation; reads the header only."""
    with open_image(path) as image:
        width, height = image.size
        turned = orientation(image) in QUARTER_TURNS
        return (width, height), (height, width) if turned else (width, height)


def exif_of(image: Image.Image) -> Image.Exif:
    """EXIF data. In a PNG only if they precede the pixels: else Pillow would decode all of it."""
    if image.format == "PNG" and "exif" not in image.info:
        return Image.Exif()
    return image.getexif()


def orientation(image: Image.Image) -> int:
    return exif_of(image).get(ExifTags.Base.Orientation, UPRIGHT)


def row_bands(width: int, height: int) -> Iterator[slice]:
    """The rows of a picture in bands, so that copies of a band take little memory."""
    rows = max(1, ROWS_PIXELS // width)
    return (slice(start, min(start + rows, height)) for start in range(0, height, rows))


def pixels_of(image: Image.Image) -> UInt8[np.ndarray, "H W D"]:
    if image.mode == "F":
        raise ValueError("its pixels are floating-point numbers")
    if image.mode.startswith("I"):  # 16-bit grey, which convert("RGB") would clip
        deep = np.asarray(image)
        if deep.min() < 0 or deep.max() > MAX_GREY:
            raise ValueError("its pixels do not fit into 16 bits")
        grey = (deep >> 8).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    return np.array(image.convert("RGBA" if image.has_transparency_data else "RGB"))


def flatten_alpha(pixels: UInt8[np.ndarray, "H W D"], grey: int) -> UInt8[np.ndarray, "H W D"]:
    """Put transparent pixels over a grey level, in place; alpha stays."""
    if pixels.shape[2] == 3:
        return pixels
    for rows in row_bands(*pixels.shape[1::-1]):
        colors, alpha = pixels[rows, :, :3].astype(np.uint16), pixels[rows, :, 3:].astype(np.uint16)
        pixels[rows, :, :3] = (colors * alpha + grey * (255 - alpha) + 127) // 255
    return pixels


def straight_alpha(pixels: UInt8[np.ndarray, "H W D"]) -> UInt8[np.ndarray, "H W D"]:
    """Colours over black as files with transparency have them; what is hidden becomes white."""
    if pixels.shape[2] == 3:
        return pixels
    alpha = pixels[..., 3:].astype(np.float32)
    colors = np.where(
        alpha > 0, 255 * pixels[..., :3].astype(np.float32) / np.maximum(alpha, 1), WHITE
    )
    return np.dstack([colors.round().clip(0, 255).astype(np.uint8), pixels[..., 3]])


def write_image(
    image: ColorPicture, path: Path | str, *, exif: bytes = b"", icc_profile: bytes | None = None
) -> None:
    with atomic_path(path) as draft:
        Image.fromarray(image.cpu().numpy()).save(
            draft,
            quality=QUALITY,
            subsampling=0,
            compress_level=PNG_LEVEL,
            exif=exif,
            icc_profile=icc_profile,
        )


def jpeg(pixels: UInt8[np.ndarray, "H W 3"], quality: int = LOOK_QUALITY) -> bytes:
    """A picture to look at, not to measure, as the content of a file."""
    content = BytesIO()
    Image.fromarray(pixels).save(content, "JPEG", quality=quality)
    return content.getvalue()


def picture_bytes(pixels: UInt8[np.ndarray, "H W D"], form: Literal["png", "jpeg"]) -> bytes:
    """A picture to put into a file; alpha is left out where it hides nothing, and of JPEG."""
    if form == "jpeg":
        return jpeg(np.ascontiguousarray(pixels[..., :3]), QUALITY)
    file, opaque = BytesIO(), pixels[..., 3:].min(initial=WHITE) == WHITE
    Image.fromarray(pixels[..., :3] if opaque else pixels).save(
        file, "png", compress_level=PNG_LEVEL
    )
    return file.getvalue()


def jpeg_thumbnail(path: Path, side: int) -> bytes:
    """A picture of at most `side` pixels in width and height, as the content of a file."""
    with open_image(path) as image:
        small = image.convert("RGB")
        small.thumbnail((side, side))
        return jpeg(np.asarray(small))


def write_numbers(numbers: Float[Tensor, "H W"], path: Path | str) -> None:
    """Write one number a pixel as a TIFF of 32-bit floats."""
    with atomic_path(path) as draft:
        values = Image.fromarray(numbers.float().cpu().numpy())
        values.save(draft, format="TIFF", compression="tiff_adobe_deflate")


def _open(file: BinaryIO | BytesIO, path: Path) -> Image.Image:
    start = file.read(FTYP_BYTES)
    file.seek(0)
    brands = start[8 : int.from_bytes(start[:4])]
    try:
        if start.startswith(JPEG_START):  # not by `Image.open`, which has a limit of its own
            image = JpegImageFile(file)
        elif start[4:8] == b"ftyp" and any(brand in brands for brand in HEIC_BRANDS):
            image = _open_heic(file, path)
        else:
            image = Image.open(file, formats=IMAGE_FORMATS)
    except UnidentifiedImageError as error:
        raise ValueError(f"it is no picture, or none of {', '.join(IMAGE_FORMATS)}") from error
    except Image.DecompressionBombError as error:
        raise _too_large(path) from error
    if image.width * image.height > IMAGE_MAX_PIXELS:
        raise _too_large(path)
    return image


def _open_heic(file: BinaryIO | BytesIO, path: Path) -> Image.Image:
    """Upright: libheif applies the rotation, whatever the EXIF data say."""
    try:
        from pillow_heif import HeifImageFile
    except ImportError as error:
        raise StyleSplatError(
            f"Cannot read {path}: it is HEIC. `pip install 'stylesplat[heic]'` makes it readable."
        ) from error
    return HeifImageFile(file)


def _too_large(path: Path) -> StyleSplatError:
    return StyleSplatError(
        f"The picture {path} has more than {IMAGE_MAX_PIXELS // 10**6} megapixels. Scale it to "
        "half its width and height."
    )

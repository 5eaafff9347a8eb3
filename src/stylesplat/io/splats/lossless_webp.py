"""Bytes as the pixels of lossless WebP pictures, whose sizes are known before they are decoded."""

import io
import warnings

import numpy as np
from jaxtyping import UInt8
from PIL import Image

METHOD, QUALITY = 1, 0  # of the search: more take three times as long for a fiftieth of the size
HEADER = 30  # bytes that tell the size
SIDE_BITS = 14  # of a side of a plain picture
LONGEST = 2**SIDE_BITS - 1  # side

Pixels = UInt8[np.ndarray, "H W 4"]


def webp_of(pixels: Pixels) -> bytes:
    """A file of pixels, exact where they are transparent too."""
    file = io.BytesIO()
    image = Image.fromarray(pixels)
    image.save(file, "WEBP", lossless=True, exact=True, method=METHOD, quality=QUALITY)
    return file.getvalue()


def webp_size(content: bytes) -> tuple[int, int]:
    """Width and height, from the header (https://developers.google.com/speed/webp/docs).

    Raises:
        ValueError: If it is no WebP file, or a lossy one.
    """
    head = content[:HEADER]
    if len(head) < HEADER or head[:4] != b"RIFF" or head[8:12] != b"WEBP":
        raise ValueError("it is no WebP picture")
    if head[12:16] == b"VP8L":
        sides = int.from_bytes(head[21:25], "little")
        return 1 + (sides & LONGEST), 1 + (sides >> SIDE_BITS & LONGEST)
    if head[12:16] == b"VP8X":
        return 1 + int.from_bytes(head[24:27], "little"), 1 + int.from_bytes(head[27:30], "little")
    raise ValueError("its pixels are rounded: it is a lossy picture")


def webp_pixels(content: bytes) -> Pixels:
    """The pixels of a file whose size was found fit.

    Raises:
        ValueError: If it is damaged.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            image = Image.open(io.BytesIO(content), formats=("WEBP",))
            return np.asarray(image.convert("RGBA"))
    except MemoryError:
        raise
    except Exception as error:  # Pillow raises all kinds
        raise ValueError(f"it is damaged ({error})") from error

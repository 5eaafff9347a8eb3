"""Bytes as the pixels of lossless WebP pictures, whose sizes are known before they are decoded."""

import io
import struct
import warnings

import numpy as np
from jaxtyping import UInt8
from PIL import Image

METHOD, QUALITY = 1, 0  # of the search: more take three times as long for a fiftieth of the size
HEADER = 30  # bytes that tell the size
CHUNK = struct.Struct("<4sI")  # a part's name and size
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
    if head[12:16] == b"VP8X" and _is_lossless(content):
        return 1 + int.from_bytes(head[24:27], "little"), 1 + int.from_bytes(head[27:30], "little")
    raise ValueError("it is a lossy or moving picture, whose pixels are no numbers")


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


def _is_lossless(content: bytes) -> bool:
    """Whether the first part of a file that is about pixels is of a single lossless picture."""
    place = HEADER
    while place + CHUNK.size <= len(content):
        name, size = CHUNK.unpack_from(content, place)
        if name in (b"VP8L", b"VP8 ", b"ALPH", b"ANIM", b"ANMF"):
            return name == b"VP8L"
        place += CHUNK.size + size + size % 2
    return False

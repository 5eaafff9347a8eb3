import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps

from capture_files import save_noise
from stylesplat.errors import StyleSplatError
from stylesplat.io.images import image_sizes, read_image
from stylesplat.io.label_maps import read_label_map
from stylesplat.io.style_pictures import read_style

SUFFIXES = ("png", "jpg", "webp", "tiff", "bmp", "gif", "ppm", "tga", "avif")
PIXELS = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)


def header_of_png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + check

    size = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = chunk(b"IDAT", zlib.compress(bytes(100)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + data + chunk(b"IEND", b"")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_is_read(tmp_path: Path, suffix: str):
    Image.fromarray(PIXELS).save(tmp_path / f"a.{suffix}")
    assert read_image(tmp_path / f"a.{suffix}").shape == PIXELS.shape


def test_other_formats_are_refused_by_name(tmp_path: Path):
    Image.fromarray(PIXELS).save(tmp_path / "a.png", format="PCX")
    with pytest.raises(StyleSplatError, match=r"a\.png: it is no picture, or none of JPEG, PNG"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("size", [(13_000, 13_000), (60_000, 60_000), (2**16, 2**12)])
def test_too_many_pixels_are_refused_before_they_are_decoded(tmp_path: Path, size):
    (tmp_path / "a.png").write_bytes(header_of_png(*size))
    for read in (read_image, read_label_map, read_style, image_sizes):
        with pytest.raises(StyleSplatError, match=r"a\.png has more than 134 megapixels"):
            read(tmp_path / "a.png")


@pytest.mark.parametrize("orientation", range(9))
def test_turned_as_pillow_turns(tmp_path: Path, orientation: int):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(PIXELS).save(tmp_path / "a.png", exif=exif)
    with Image.open(tmp_path / "a.png") as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png").numpy(), expected)


def test_no_memory_for_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    save_noise(tmp_path / "a.png")

    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(Image.Image, "convert", full)
    with pytest.raises(StyleSplatError, match=r"not enough memory to read the image .*a\.png"):
        read_image(tmp_path / "a.png")

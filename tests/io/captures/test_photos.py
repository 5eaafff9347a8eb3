from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import fit_photo
from stylesplat.io.images import read_image

PIXELS = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)


def pinhole(width: int, height: int) -> Lens:
    return Lens("PINHOLE", width, height, (50.0, 52.0, width / 2, height / 2))


def save(path: Path, pixels: np.ndarray, orientation: int | None = None) -> Path:
    exif = Image.Exif()
    if orientation:
        exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(pixels).save(path, exif=exif)
    return path


def test_other_kinds_of_colour(tmp_path: Path):
    flat = Image.new("RGB", (8, 6), (10, 100, 200))
    palette = flat.convert("P", palette=Image.Palette.ADAPTIVE)
    palette.save(tmp_path / "palette.png")
    clear = np.asarray(palette)[0, 0].item()
    palette.save(tmp_path / "clear.png", transparency=clear)
    flat.convert("CMYK").save(tmp_path / "print.jpg", quality=100)
    Image.new("LA", (8, 6), (100, 51)).save(tmp_path / "veil.png")
    Image.fromarray(PIXELS[..., 0] > 127).save(tmp_path / "bits.png")
    Image.fromarray(np.full((6, 8), 100 * 256 + 77, np.uint16)).save(tmp_path / "deep.png")
    for name, color in (
        ("palette.png", (10, 100, 200)),
        ("clear.png", (255, 255, 255)),
        ("print.jpg", (10, 100, 200)),
        ("veil.png", (224, 224, 224)),  # a fifth of 100 and four of white
        ("deep.png", (100, 100, 100)),
    ):
        image = read_image(tmp_path / name).numpy()
        np.testing.assert_allclose(image, np.full((6, 8, 3), color), atol=1, err_msg=name)  # JPEG
    bits = read_image(tmp_path / "bits.png").numpy()
    np.testing.assert_array_equal(bits, 255 * (PIXELS[..., :1] > 127).repeat(3, axis=2))
    for pixels in (np.full((4, 4), 65536, np.int32), np.ones((4, 4), np.float32)):
        Image.fromarray(pixels).save(tmp_path / "a.tiff")
        with pytest.raises(StyleSplatError, match=r"a\.tiff: its pixels "):
            read_image(tmp_path / "a.tiff")


def test_transparency_shows_white(tmp_path: Path):
    alpha = np.zeros((6, 8, 1), np.uint8)
    alpha[:3], alpha[3] = 255, 128
    image = read_image(save(tmp_path / "a.png", np.concatenate([PIXELS, alpha], axis=2))).numpy()
    np.testing.assert_array_equal(image[:3], PIXELS[:3])
    assert (image[4:] == 255).all()
    half = (PIXELS[3].astype(float) * 128 + 255 * 127) / 255
    np.testing.assert_allclose(image[3], half, atol=1)  # one level for Pillow's rounding


@pytest.mark.parametrize(
    ("size", "expected"), [((6, 8), np.rot90(PIXELS, -1)), ((8, 6), PIXELS)], ids=str
)
def test_a_turned_photo_fits_its_camera_either_way(tmp_path: Path, size: tuple, expected):
    photo = fit_photo(save(tmp_path / "a.png", PIXELS, orientation=6), pinhole(*size))
    np.testing.assert_array_equal(photo.read().numpy(), expected)


@pytest.mark.parametrize("orientation", range(2, 9))
def test_poses_belong_to_the_pixels_as_stored(tmp_path: Path, orientation: int):
    square = PIXELS[:, :6]
    for pixels in (PIXELS, square):
        path = save(tmp_path / "a.png", pixels, orientation)
        for scale in (1, 2):
            photo = fit_photo(path, pinhole(scale * pixels.shape[1], scale * pixels.shape[0]))
            np.testing.assert_array_equal(photo.read().numpy(), pixels)
            assert photo.as_stored


@pytest.mark.parametrize("orientation", range(5, 9))
def test_only_the_turned_photo_fits_a_turned_camera(tmp_path: Path, orientation: int):
    path = save(tmp_path / "a.png", PIXELS, orientation)
    photo = fit_photo(path, pinhole(6, 8))
    np.testing.assert_array_equal(photo.read(), read_image(path))
    assert not photo.as_stored


@pytest.mark.parametrize("size", [(16, 12), (4, 3), (17, 13), (15, 11)], ids=str)
def test_a_multiple_scales_the_camera(tmp_path: Path, size: tuple[int, int]):
    photo = fit_photo(save(tmp_path / "a.png", PIXELS), pinhole(*size))
    assert photo.lens.size == photo.size == (8, 6)
    assert photo.lens.params[0] == pytest.approx(50 * 8 / size[0])
    np.testing.assert_array_equal(photo.read().numpy(), PIXELS)


def test_another_shape_does_not_fit(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"a\.png is 8x6, .*its camera's 100x100"):
        fit_photo(save(tmp_path / "a.png", PIXELS), pinhole(100, 100))


def test_shrinking_averages_the_pixels_covered(tmp_path: Path):
    pixels = np.random.default_rng(0).integers(0, 256, (12, 16, 3), np.uint8)
    photo = fit_photo(save(tmp_path / "a.png", pixels), pinhole(16, 12)).resized(4, 3)
    expected = pixels.reshape(3, 4, 4, 4, 3).astype(float).mean(axis=(1, 3))
    np.testing.assert_allclose(photo.read().numpy(), expected, atol=0.5)  # rounding to 8 bits


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_corrupt_files(tmp_path: Path, suffix: str):
    path = tmp_path / f"a.{suffix}"
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    whole = save(path, noise).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    photo = fit_photo(path, pinhole(64, 64))  # the header is intact
    with pytest.raises(StyleSplatError, match=rf"Cannot read the image .*a\.{suffix}: .*truncated"):
        photo.read()
    for content in (b"<html>404</html>", b""):
        path.write_bytes(content)
        with pytest.raises(StyleSplatError, match=rf"Cannot read the image .*a\.{suffix}"):
            fit_photo(path, pinhole(64, 64))

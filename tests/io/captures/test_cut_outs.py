"""Photos with transparency, from the file to the capture."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from capture_files import HEIGHT, WIDTH, write_capture, write_cut_outs
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import fit_photo
from stylesplat.io.label_maps import write_label_map

BARREL = Lens("OPENCV", WIDTH, HEIGHT, (60.0, 62.0, 31.0, 25.0, 0.2, 0.0, 0.0, 0.0))
PINHOLE = Lens("PINHOLE", WIDTH, HEIGHT, (60.0, 62.0, 31.0, 25.0))


def save_rgba(path: Path, color: int = 200, alpha: np.ndarray | int = 255) -> Path:
    pixels = np.full((HEIGHT, WIDTH, 4), color, np.uint8)
    pixels[..., 3] = alpha
    Image.fromarray(pixels).save(path)
    return path


def left_half() -> np.ndarray:
    return np.where(np.arange(WIDTH) < WIDTH // 2, 255, 0)[None]


@pytest.fixture
def cut_outs(tmp_path: Path) -> Path:
    return write_cut_outs(tmp_path / "balls")


def test_photos_are_over_black_and_alphas_beside_them(cut_outs: Path):
    capture = load(cut_outs)
    assert capture.alphas is not None
    for row, name in enumerate(capture.cameras.names):
        with Image.open(cut_outs / "images" / name) as image:
            pixels = np.asarray(image).astype(float)
        alpha = capture.alphas[row]
        assert alpha is not None
        np.testing.assert_array_equal(alpha, pixels[..., 3])
        expected = pixels[..., :3] * pixels[..., 3:] / 255
        np.testing.assert_allclose(capture.photos[row], expected, atol=0.51)  # rounding to 8 bits


def test_what_is_opaque_is_an_object(cut_outs: Path):
    capture = load(cut_outs)
    assert capture.object_names == {1: "object"}
    for row in range(len(capture)):
        labels, alpha = capture.labels(row), capture.alpha(row)
        assert labels is not None and alpha is not None
        assert torch.equal(labels, (alpha >= 128).int())
        assert set(labels.unique().tolist()) == {0, 1}


def test_label_maps_come_before_alpha(cut_outs: Path):
    write_label_map(torch.full((36, 48), 5), cut_outs / "object_mask/0003.png")
    capture = load(cut_outs)
    assert capture.object_names == {} and capture.alphas is not None
    assert capture.labels(0) is None
    labels = capture.labels(3)
    assert labels is not None and int(labels.min()) == 5


def test_some_photos_may_have_no_alpha(tmp_path: Path):
    folder = write_capture(tmp_path / "a")
    save_rgba(folder / "images/002.png", alpha=left_half())
    capture = load(folder)
    assert capture.alpha(0) is None and capture.labels(0) is None
    alpha = capture.alpha(1)
    assert alpha is not None and float(alpha.float().mean()) == 127.5
    with Image.open(folder / "images/001.png") as image:
        np.testing.assert_array_equal(capture.photos[0], np.asarray(image))


@pytest.mark.parametrize("lens", [PINHOLE, BARREL], ids=["pinhole", "barrel"])
@pytest.mark.parametrize("factor", [1, 4])
def test_colours_that_nobody_sees_do_not_leak(tmp_path: Path, lens: Lens, factor: int):
    # White, but where it is transparent: any average that did not weigh by alpha would be darker
    # than white once divided by it.
    pixels = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    soft = np.linspace(0, 255, WIDTH).round().astype(np.uint8)
    pixels[..., :3], pixels[..., 3] = np.where(soft > 0, 255, 0)[None, :, None], soft
    Image.fromarray(pixels).save(tmp_path / "a.png")
    photo = fit_photo(tmp_path / "a.png", lens)
    width, height = photo.size
    small = photo.resized(width // factor, height // factor).read_with_alpha().int()
    assert (small[..., 0] - small[..., 3]).abs().max() <= 1  # both are rounded

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from balls import CAMERAS
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load

WIDTH, HEIGHT = CAMERAS[0].size
USED = torch.arange(HEIGHT)[:, None] < torch.arange(WIDTH)  # above the diagonal


def write(folder: Path, save: Callable[[Path], None], **lens: Any) -> Path:
    """The balls, whose first photo has a mask."""
    write_ball_capture(folder, masks=False)
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][0] |= {"mask_path": "masks/mask"}
    content |= lens
    path.write_text(json.dumps(content))
    (folder / "masks").mkdir()
    save(folder / "masks/mask")
    return folder


def picture(values: Tensor, mode: str) -> Image.Image:
    return Image.fromarray((values * 1).numpy().astype(np.uint8), "L").convert(mode)


def rgba(used: Tensor) -> Image.Image:
    colors = np.full((*used.shape, 3), 255, np.uint8)
    return Image.fromarray(np.dstack([colors, (255 * used).numpy().astype(np.uint8)]))


@pytest.mark.parametrize(
    ("image", "format"),
    [
        (picture(255 * USED, "L"), "PNG"),
        (picture(USED, "L"), "PNG"),  # 0 and 1
        (picture(255 * USED, "1"), "PNG"),
        (picture(255 * USED, "P"), "PNG"),
        (picture(255 * USED, "RGB"), "PNG"),
        (picture(255 * USED, "RGBA"), "PNG"),
        (rgba(USED), "PNG"),
        (Image.fromarray(USED.numpy().astype(np.uint16)), "PNG"),
        (picture(255 * USED, "L"), "TIFF"),
    ],
)
def test_pixels_that_are_not_0_are_valid(tmp_path: Path, image: Image.Image, format: str):
    capture = load(write(tmp_path, lambda path: image.save(path, format)))
    valid = capture.valid(0)
    assert valid is not None and torch.equal(valid, USED)
    assert capture.valid(1) is None


def test_a_lossy_mask(tmp_path: Path):
    image = picture(255 * USED, "L")
    capture = load(write(tmp_path, lambda path: image.save(path, "JPEG", quality=60)))
    valid = capture.valid(0)
    assert valid is not None and (valid == USED).float().mean() > 0.98


def test_small_masks_and_small_photos(tmp_path: Path, said: list[str]):
    image = picture(255 * USED[::2, ::2], "L")
    folder = write(tmp_path, lambda path: image.save(path, "PNG"))
    valid = load(folder).valid(0)
    repeated = USED[::2, ::2].repeat_interleave(2, 0).repeat_interleave(2, 1)
    assert valid is not None and torch.equal(valid, repeated)
    assert f"1 of {len(CAMERAS)} photos" in said[0]
    small = load(folder, downscale=4.0).valid(0)
    blocks = repeated.unflatten(1, (-1, 4)).unflatten(0, (-1, 4)).all(dim=3).all(dim=1)
    assert small is not None and torch.equal(small, blocks)


def test_masks_are_undistorted_with_their_photos(tmp_path: Path):
    """The photo shows its mask."""

    def save(path: Path) -> None:
        image = picture(255 * USED, "L")
        image.save(path, "PNG")
        image.convert("RGB").save(tmp_path / "images/0000.jpg", "PNG")

    capture = load(write(tmp_path, save, k1=-0.2))
    valid, photo = capture.valid(0), capture.photos[0]
    assert valid is not None and 0.2 < valid.float().mean() < 0.6
    assert (photo[valid] == 255).all()
    assert (photo[~valid] < 255).all()


def test_photos_whose_masks_are_missing_are_left_out(tmp_path: Path, said: list[str]):
    capture = load(write(tmp_path, lambda path: None))
    assert len(capture) == len(CAMERAS) - 1
    assert "masks/mask" in said[0]


def test_a_mask_of_another_shape(tmp_path: Path):
    image = Image.new("L", (HEIGHT, WIDTH))
    with pytest.raises(StyleSplatError, match=f"masks/mask is {HEIGHT}x{WIDTH}"):
        load(write(tmp_path, lambda path: image.save(path, "PNG")))

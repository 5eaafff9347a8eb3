from pathlib import Path

import numpy as np
import pytest
import torch

from capture_files import save_noise, write_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.kinds import is_posed

# A camera at (1, 2, 3) that looks along +x with z up; LLFF's columns are down, right, back
POSE = [[0, 0, -1, 1.0], [0, -1, 0, 2.0], [-1, 0, 0, 3.0]]


def write(folder: Path, count: int = 3, images: str = "images", *, reduced: int = 1) -> Path:
    for row in range(count):
        save_noise(folder / images / f"{row}.png", (64 // reduced, 48 // reduced))
    rows = []
    for row in range(count):
        pose = np.array(POSE)
        pose[0, 3] += row
        matrix = np.concatenate([pose, [[48.0], [64.0], [60.0]]], axis=1)
        rows.append([*matrix.ravel(), 0.1, 10.0])
    np.save(folder / "poses_bounds.npy", rows)
    return folder


@pytest.mark.parametrize(("images", "reduced"), [("images", 1), ("images_4", 4), ("images_8", 8)])
def test_poses_and_cameras(tmp_path: Path, images: str, reduced: int):
    folder = write(tmp_path, images=images, reduced=reduced)
    assert is_posed(folder)
    cameras = load(folder).cameras
    assert cameras.names == ("0.png", "1.png", "2.png")
    assert cameras.sizes[0].tolist() == [64 / reduced, 48 / reduced]
    assert cameras.Ks[0, 0].tolist() == pytest.approx([60 / reduced, 0, 32 / reduced])
    ahead, left, above = ([1 + 5, 2, 3, 1.0], [1, 2 + 5, 3, 1.0], [1, 2, 3 + 5, 1.0])
    expected = [[0, 0, 5, 1], [-5, 0, 0, 1], [0, -5, 0, 1.0]]  # x right, y down, z forward
    seen = torch.tensor([ahead, left, above]) @ cameras.viewmats[0].T
    torch.testing.assert_close(seen, torch.tensor(expected))
    assert cameras.positions[2].tolist() == pytest.approx([3, 2, 3])


def test_the_folder_with_as_many_photos(tmp_path: Path):
    folder = write(tmp_path, images="images_4", reduced=4)
    save_noise(folder / "images/only.png", (64, 48))
    assert load(folder).cameras.names == ("0.png", "1.png", "2.png")
    (folder / "images_4/1.png").unlink()
    with pytest.raises(StyleSplatError, match=r"3 poses.*images/ has 1 .*images_4/ has 2 "):
        load(folder)


def test_another_shape(tmp_path: Path):
    folder = write(tmp_path)
    np.save(folder / "poses_bounds.npy", np.zeros((3, 14)))
    with pytest.raises(StyleSplatError, match=r"poses_bounds\.npy.*\(3, 14\)"):
        load(folder)


def test_colmap_is_read_first_with_a_line(tmp_path: Path, said: list[str]):
    write_capture(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 14)))
    assert len(load(tmp_path)) == 3
    assert "sparse/0" in said[0] and "poses_bounds.npy" in said[0]

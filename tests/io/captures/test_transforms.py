import json
import math
from pathlib import Path
from typing import Any

import pytest
import torch

from capture_files import lenses_of, save_noise
from still_life.nerfstudio import write_transforms
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.transforms import read_transforms
from stylesplat.scene.cameras import Cameras

# A camera at (1, 2, 3) that looks along +x with z up; OpenGL's columns are right, up, back
POSE = [[0, 0, -1, 1.0], [-1, 0, 0, 2.0], [0, 1, 0, 3.0], [0, 0, 0, 1.0]]
LENS = {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 62.0, "cx": 31.0, "cy": 25.0}


def write(folder: Path, frames: list[dict[str, Any]] | None = None, **shared: Any) -> Path:
    if frames is None:
        frames = [{"file_path": "images/a.png", "transform_matrix": POSE}]
    (folder / "transforms.json").write_text(json.dumps({**shared, "frames": frames}))
    return folder


def test_opengl_axes_become_opencv(tmp_path: Path):
    viewmat = read_transforms(write(tmp_path, **LENS)).viewmats[0]
    ahead, left, above = ([1 + 5, 2, 3, 1.0], [1, 2 + 5, 3, 1.0], [1, 2, 3 + 5, 1.0])
    expected = [[0, 0, 5, 1], [-5, 0, 0, 1], [0, -5, 0, 1]]  # x right, y down, z forward
    seen = torch.tensor([ahead, left, above], dtype=torch.float64) @ viewmat.T
    torch.testing.assert_close(seen, torch.tensor(expected, dtype=torch.float64))


def test_intrinsics_for_all_or_per_frame(tmp_path: Path):
    frames = [
        {"file_path": "images/a.png", "transform_matrix": POSE},
        {"file_path": "images/b.png", "transform_matrix": POSE, "fl_x": 99.0},
    ]
    lenses = lenses_of(read_transforms(write(tmp_path, frames, **LENS)))
    assert [lens.params[:4] for lens in lenses] == [(60, 62, 31, 25), (99, 62, 31, 25)]
    assert lenses[0].is_pinhole and lenses[0].size == (64, 48)


def test_only_a_field_of_view(tmp_path: Path):
    save_noise(tmp_path / "images/a.png", (64, 48))
    (lens,) = lenses_of(read_transforms(write(tmp_path, camera_angle_x=math.pi / 2)))
    assert lens.size == (64, 48)
    assert lens.params[:4] == pytest.approx((32, 32, 32, 24))


@pytest.mark.parametrize(
    ("extra", "model", "tail"),
    [
        ({}, "FULL_OPENCV", (0.1, 0.2, 0.3, 0.4, 0, 0, 0, 0)),
        ({"k3": 0.5}, "FULL_OPENCV", (0.1, 0.2, 0.3, 0.4, 0.5, 0, 0, 0)),
        ({"is_fisheye": True, "k3": 0.5}, "OPENCV_FISHEYE", (0.1, 0.2, 0.5, 0)),
        ({"camera_model": "OPENCV_FISHEYE", "k4": 0.6}, "OPENCV_FISHEYE", (0.1, 0.2, 0, 0.6)),
    ],
)
def test_distortion(tmp_path: Path, extra: dict[str, Any], model: str, tail: tuple[float, ...]):
    content = {**LENS, "k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4, **extra}
    (lens,) = lenses_of(read_transforms(write(tmp_path, **content)))
    assert (lens.model, lens.params) == (model, (60, 62, 31, 25, *tail))
    assert not lens.is_pinhole


def test_names_within_the_common_folder_are_sorted(tmp_path: Path):
    files = ["x/train/b.png", "x/test/a.png", "x/train/a.png"]
    frames = [{"file_path": name, "transform_matrix": POSE} for name in files]
    names = read_transforms(write(tmp_path, frames, **LENS)).names
    assert names == ("test/a.png", "train/a.png", "train/b.png")


def random_cameras(count: int = 3) -> Cameras:
    generator = torch.Generator().manual_seed(0)
    viewmats = torch.eye(4).repeat(count, 1, 1)
    rotations = torch.linalg.qr(torch.randn(count, 3, 3, generator=generator)).Q
    viewmats[:, :3, :3] = rotations * torch.det(rotations)[:, None, None]
    viewmats[:, :3, 3] = torch.randn(count, 3, generator=generator)
    Ks = torch.eye(3).repeat(count, 1, 1)
    Ks[:, 0, 0], Ks[:, 1, 1], Ks[:, 0, 2], Ks[:, 1, 2] = 60.1, 62.3, 31.7, 25.9
    names = tuple(f"{i}.png" for i in range(count))
    return Cameras(viewmats, Ks, torch.tensor([[64, 48]]).repeat(count, 1), names)


def test_round_trip(tmp_path: Path):
    cameras = random_cameras()
    points = torch.randn(5, 3)
    colors = torch.arange(15, dtype=torch.uint8).reshape(5, 3)
    write_transforms(cameras, tmp_path, points=points, point_colors=colors)
    posed = read_transforms(tmp_path)
    assert posed.names == cameras.names
    assert posed.paths[0] == tmp_path / "images" / "0.png"
    torch.testing.assert_close(
        posed.viewmats.float(), cameras.viewmats, atol=3e-7, rtol=0
    )  # one unit in the last place
    assert torch.equal(torch.stack([lens.K for lens in lenses_of(posed)]), cameras.Ks)
    assert posed.points is not None and torch.equal(posed.points, points)
    assert posed.point_colors is not None and torch.equal(posed.point_colors, colors)


@pytest.mark.parametrize("key", ["fl_x", "h"])
def test_missing_intrinsics(tmp_path: Path, key: str):
    content = {name: value for name, value in LENS.items() if name != key}
    with pytest.raises(StyleSplatError, match=f"lacks the key '{key}'"):
        read_transforms(write(tmp_path, **content))


@pytest.mark.parametrize(
    ("frames", "shared", "match"),
    [
        ([], {}, "no frames, so no cameras"),
        (None, {"fl_x": "wide"}, "malformed"),
        (None, {"camera_model": "EQUIRECTANGULAR"}, "model EQUIRECTANGULAR"),
        (None, {"fl_x": -1.0}, "no focal length"),
        (None, {"ply_file_path": "none.ply"}, r"none\.ply: No such file"),
    ],
)
def test_malformed_content(tmp_path: Path, frames: Any, shared: dict[str, Any], match: str):
    with pytest.raises(StyleSplatError, match=match):
        read_transforms(write(tmp_path, frames, **{**LENS, **shared}))

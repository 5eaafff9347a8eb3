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
    ],
)
def test_malformed_content(tmp_path: Path, frames: Any, shared: dict[str, Any], match: str):
    with pytest.raises(StyleSplatError, match=match):
        read_transforms(write(tmp_path, frames, **{**LENS, **shared}))


def frame(name: str, x: float = 1.0, **rest: Any) -> dict[str, Any]:
    pose = [[*row] for row in POSE]
    pose[0][3] = x
    return {"file_path": name, "transform_matrix": pose, **rest}


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """A folder with eight photos."""
    for number in range(8):
        save_noise(tmp_path / f"images/{number}.png", (64, 48))
    return tmp_path


NAMES = [f"images/{number}.png" for number in range(8)]


def write_splits(folder: Path, **splits: range) -> Path:
    for split, rows in splits.items():
        frames = [frame(f"./images/{row}", x=row) for row in rows]
        content = {"camera_angle_x": 0.5, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize(
    ("splits", "names", "held_out"),
    [
        ({"train": range(8)}, range(8), None),
        ({"train": range(6), "test": range(6, 8)}, range(8), {6, 7}),
        ({"train": range(6), "val": range(6, 8)}, range(8), {6, 7}),
        ({"train": range(5), "test": range(5, 7), "val": range(7, 8)}, range(7), {5, 6}),
        ({"train": range(8), "test": range(6, 8)}, range(8), None),
        ({"test": range(6)}, range(6), None),
    ],
)
def test_splits_in_files(
    photos: Path, splits: dict[str, range], names: range, held_out: set[int] | None, said: list[str]
):
    posed = read_transforms(write_splits(photos, **splits))
    assert posed.names == tuple(f"{row}.png" for row in names)
    expected = None if held_out is None else {f"{row}.png" for row in held_out}
    assert posed.held_out == expected
    assert (f"The {len(expected or ())} photos of" in "".join(said)) == (expected is not None)
    assert posed.viewmats[1, 2, 3] == pytest.approx(-1)  # each photo has its own pose


def test_every_split_has_its_own_field_of_view(photos: Path):
    write_splits(photos, train=range(4))
    content = {"camera_angle_x": math.pi / 2, "frames": [frame("images/7")]}
    (photos / "transforms_test.json").write_text(json.dumps(content))
    focals = [lens.params[0] for lens in lenses_of(read_transforms(photos))]
    assert focals == pytest.approx([32 / math.tan(0.25)] * 4 + [32])


def test_splits_in_lists(photos: Path, said: list[str]):
    lists = {
        "train_filenames": ["images/0.png", "./images/1.png", "images\\2.png"],
        "test_filenames": NAMES[3:5],
        "val_filenames": NAMES[4:6],
    }
    posed = read_transforms(write(photos, [frame(name) for name in NAMES], **lists, **LENS))
    assert posed.names == tuple(f"{row}.png" for row in range(5))
    assert posed.held_out == {"3.png", "4.png"}
    assert "2 photos of test_filenames of transforms.json" in said[0]
    assert "3 photos are neither" in said[1]


@pytest.mark.parametrize(
    "name",
    [
        "images\\{}.png",
        ".\\images\\{}.png",
        "C:\\Users\\me\\fox\\images\\{}.png",
        "C:/Users/me/fox/images/{}.png",
        "/home/me/fox/images/{}.png",
        "../elsewhere/images/{}.png",
        "data/fox/images/{}",
        "Images/{}.PNG",
        "./IMAGES/{}",
    ],
)
def test_names_of_other_machines(photos: Path, name: str, said: list[str]):
    frames = [frame(name.format(number)) for number in range(8)]
    posed = read_transforms(write(photos, frames, **LENS))
    assert posed.paths == tuple(photos / each for each in NAMES)
    moved = any(word in name for word in ("me", "elsewhere", "fox"))
    assert ["8 of 8 photos of transforms.json lead elsewhere" in line for line in said] == (
        [True] if moved else []
    )


def test_missing_photos_of_another_machine_are_named(photos: Path):
    frames = [frame(f"/home/me/fox/images/{number}.png") for number in range(10)]
    posed = read_transforms(write(photos, frames, **LENS))
    assert posed.names == tuple(f"{number}.png" for number in range(10))


def test_two_names_are_not_taken_for_one_photo(tmp_path: Path):
    save_noise(tmp_path / "0.png", (64, 48))
    frames = [frame("/home/me/left/0.png"), frame("/home/me/right/0.png")]
    posed = read_transforms(write(tmp_path, frames, **LENS))
    assert not any(path.exists() for path in posed.paths)


@pytest.mark.parametrize(
    ("keys", "signs"),
    [({"from_na": True}, (1, 1, 1)), ({"normal_mts_args": [0]}, (-1, -1, 1)), ({}, (1, -1, -1))],
)
def test_declared_axes_of_cameras(tmp_path: Path, keys: dict[str, Any], signs: tuple[int, ...]):
    viewmat = read_transforms(write(tmp_path, None, **keys, **LENS)).viewmats[0]
    axes = torch.tensor(POSE, dtype=torch.float64)[:3, :3] * torch.tensor(signs)
    torch.testing.assert_close(viewmat[:3, :3], axes.T)


def test_keys_that_are_not_used_are_named(tmp_path: Path, said: list[str]):
    frames = [frame("images/a.png", depth_file_path="depth/a.png", time=0.5)]
    read_transforms(write(tmp_path, frames, aabb_scale=16, applied_scale=0.5, **LENS))
    (line,) = said
    assert "depth_file_path, time" in line and "aabb" not in line


@pytest.mark.parametrize("key", ["latlong", "orthographic", "ftheta_p0"])
def test_lenses_that_no_photo_has(tmp_path: Path, key: str):
    with pytest.raises(StyleSplatError, match=f"{key} cameras"):
        read_transforms(write(tmp_path, None, **LENS, **{key: True}))


def test_contradicting_lenses(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="is_fisheye, but the camera model PINHOLE"):
        read_transforms(write(tmp_path, **LENS, camera_model="PINHOLE", is_fisheye=True))


def test_a_missing_file_of_points_costs_a_line(tmp_path: Path, said: list[str]):
    posed = read_transforms(write(tmp_path, ply_file_path="none.ply", **LENS))
    assert posed.points is None and "none.ply" in said[0]


def test_points_beside_split_files(photos: Path):
    write_splits(photos, train=range(8))
    write_transforms(random_cameras(), photos, points=torch.randn(5, 3))
    (photos / "points.ply").rename(photos / "points3d.ply")
    (photos / "transforms.json").unlink()
    points = read_transforms(photos).points
    assert points is not None and len(points) == 5

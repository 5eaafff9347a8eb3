"""Captures at coordinates that are too large for float32."""

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture, write_capture
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.captures.posed_files import RGB, XYZ
from stylesplat.io.ply import read_ply_table, write_ply_rows
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.world_offset import ORIGIN, to_world

WORLD = (4e6, -3e6, 5e6)


def move_transforms(folder: Path) -> None:
    """Move poses and points, which have doubles then, by `WORLD`."""
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    for frame in content["frames"]:
        for row, shift in zip(frame["transform_matrix"], WORLD, strict=False):
            row[3] += shift
    path.write_text(json.dumps(content))
    table = read_ply_table(folder / "points.ply")
    moved = table.astype([*((name, "<f8") for name in XYZ), *((name, "u1") for name in RGB)])
    for name, shift in zip(XYZ, WORLD, strict=True):
        moved[name] += shift
    write_ply_rows(folder / "points.ply", len(moved), moved.dtype, [moved])


def assert_moved(there: Capture, cameras: Cameras, points: torch.Tensor) -> None:
    """The places are those of a capture around the origin, and so are the photos."""
    assert there.world_offset == pytest.approx(WORLD, abs=5)
    assert all(value == round(value) for value in there.world_offset)
    assert there.cameras.viewmats.dtype == torch.float32
    found = to_world(there.cameras.positions, there.world_offset)
    torch.testing.assert_close(found, to_world(cameras.positions, WORLD), atol=2e-6, rtol=0)
    turns = there.cameras.viewmats[:, :3, :3], cameras.viewmats[:, :3, :3]
    torch.testing.assert_close(*turns, atol=1e-6, rtol=0)
    assert there.points is not None and there.points.dtype == torch.float32
    found = to_world(there.points, there.world_offset)
    torch.testing.assert_close(found, to_world(points, WORLD), atol=1e-6, rtol=0)


def test_transforms(tmp_path: Path, said: list[str]):
    folder = write_ball_capture(tmp_path / "capture", masks=False)
    plain = load(folder)
    assert plain.world_offset == ORIGIN and not said
    move_transforms(folder)
    there = load(folder, downscale=2.0)
    assert_moved(there, CAMERAS, SPLATS.means)
    assert str(folder) in said[0] and " ".join(f"{x:.0f}" for x in there.world_offset) in said[0]
    assert there.only([0, 2]).world_offset == there.world_offset


@pytest.mark.parametrize("text", [False, True])
def test_colmap(text: bool, tmp_path: Path):
    folder = write_capture(tmp_path / "capture", text=text)
    plain = load(folder)
    assert plain.points is not None and plain.world_offset == ORIGIN
    model = pycolmap.Reconstruction(folder / "sparse/0")
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array(WORLD)))
    (model.write_text if text else model.write)(folder / "sparse/0")
    assert_moved(load(folder), plain.cameras, plain.points)


def test_strays_do_not_move_it(tmp_path: Path):
    folder = write_ball_capture(tmp_path / "capture", masks=False)
    move_transforms(folder)
    content = json.loads((folder / "transforms.json").read_text())
    content["frames"][0]["transform_matrix"][0][3] = 1e5
    (folder / "transforms.json").write_text(json.dumps(content))
    there = load(folder)
    assert there.world_offset == pytest.approx(WORLD, abs=3)

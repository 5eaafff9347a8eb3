"""Poses of phone apps and of photogrammetry programs, in the files that reach people from these.

Polycam, Record3D, Metashape and RealityCapture through nerfstudio's `ns-process-data`, which writes
what their raw files say; Metashape and RealityScan also in COLMAP's text files.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from capture_files import HEIGHT, WIDTH, save_noise
from stylesplat.io.captures.capture_folder import load

# A camera at (1, 2, 3) that looks along +x with z up; OpenGL's columns are right, up, back
POSE = [[0.0, 0.0, -1.0, 1.0], [-1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
EXPECTED = torch.tensor([[0.0, -1, 0, 2], [0, 0, -1, 3], [1, 0, 0, -1], [0, 0, 0, 1]])
SIZE = {"w": WIDTH, "h": HEIGHT}


def polycam(frames: list[dict[str, Any]]) -> dict[str, Any]:
    """A lens for each frame; the orientation is not to be changed."""
    lens = {"fl_x": 60.5, "fl_y": 60.5, "cx": 31.7, "cy": 24.2, **SIZE}
    frames = [{**lens, **frame} for frame in frames]
    return {"camera_model": "OPENCV", "orientation_override": "none", "frames": frames}


def record3d(frames: list[dict[str, Any]]) -> dict[str, Any]:
    lens = {"fl_x": 60.5, "fl_y": 60.5, "cx": WIDTH / 2, "cy": HEIGHT / 2, **SIZE}
    return {**lens, "camera_model": "OPENCV", "frames": frames}


def metashape(frames: list[dict[str, Any]]) -> dict[str, Any]:
    lens = {"fl_x": 60.5, "fl_y": 60.5, "cx": 31.7, "cy": 24.2, **SIZE}
    bent = {"k1": -0.02, "k2": 0.01, "k3": 0.001, "k4": 0.0, "p1": 1e-4, "p2": -1e-4}
    return {**lens, **bent, "camera_model": "OPENCV", "frames": frames}


def reality_capture(frames: list[dict[str, Any]]) -> dict[str, Any]:
    """What bends light stays text, as the table says it."""
    lens = {"fl_x": 60.5, "fl_y": 60.5, "cx": 31.7, "cy": 24.2}
    bent = {"k1": "-0.02", "k2": "0.01", "k3": "0", "k4": "0", "p1": "0.0", "p2": "0"}
    frames = [{**frame, **lens, **bent} for frame in frames]
    shared = {"camera_model": "OPENCV", "orientation_override": "none", **SIZE}
    return {**shared, "frames": frames}


@pytest.mark.parametrize("program", [polycam, record3d, metashape, reality_capture])
def test_by_way_of_nerfstudio(program: Callable[..., dict[str, Any]], tmp_path: Path):
    names = [f"images/frame_{row:05d}.png" for row in (1, 2, 3)]
    for row, name in enumerate(names):
        save_noise(tmp_path / name, seed=row)
    frames = [{"file_path": f"./{name}", "transform_matrix": POSE} for name in names]
    (tmp_path / "transforms.json").write_text(json.dumps(program(frames)))
    capture = load(tmp_path)
    torch.testing.assert_close(capture.cameras.viewmats, EXPECTED.expand(3, 4, 4))
    assert capture.cameras.Ks[0, 0, 0] == pytest.approx(60.5, rel=0.05)
    assert len([*capture.photos]) == 3


CAMERAS = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
{camera}
"""
IMAGES = """# Image list with two lines of data per image:
#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME
#   POINTS2D[] as (X, Y, POINT3D_ID)
"""
POINTS = """# 3D point list with one line of data per point:
#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)
1 0.5 0.5 5 10 20 30 0.5 1 0 2 0
2 1.5 0.5 5 40 50 60 0.5 1 0 2 0
"""
UNDISTORTED = "1 PINHOLE 64 48 60.5 60.5 31.7 24.2"
BENT = "1 FULL_OPENCV 64 48 60.5 60.5 31.7 24.2 -0.02 0.01 0.0001 -0.0001 0.001 0 0 0"


@pytest.mark.parametrize("folder", ["sparse/0", "sparse", "."])
@pytest.mark.parametrize("camera", [UNDISTORTED, BENT])
def test_by_way_of_colmaps_text_files(folder: str, camera: str, tmp_path: Path):
    """Where people put the three files that these programs write."""
    (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    rows = [f"{id} 1 0 0 0 {-id} 0 0 1 IMG_{id:04d}.png\n\n" for id in (1, 2, 3)]
    for id in (1, 2, 3):
        save_noise(tmp_path / f"images/IMG_{id:04d}.png", seed=id)
    (tmp_path / folder / "cameras.txt").write_text(CAMERAS.format(camera=camera))
    (tmp_path / folder / "images.txt").write_text(IMAGES + "".join(rows))
    (tmp_path / folder / "points3D.txt").write_text(POINTS)
    capture = load(tmp_path)
    assert capture.cameras.viewmats[:, 0, 3].tolist() == [-1, -2, -3]
    assert capture.points is not None and len(capture.points) == 2
    assert len([*capture.photos]) == 3

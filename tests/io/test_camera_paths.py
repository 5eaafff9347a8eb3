"""Camera paths from files: nerfstudio's, and key frames."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
import torch

from balls import CAMERAS
from stylesplat.errors import StyleSplatError
from stylesplat.io.cameras import read_camera_path
from stylesplat.scene.cameras import look_at

UP = torch.tensor([0.0, 0.0, 1.0])


def nerfstudio(**changes: Any) -> dict[str, Any]:
    """What its viewer writes, of the first cameras."""
    poses = torch.linalg.inv(CAMERAS.viewmats[:3].double())
    poses[:, :3, 1:3] *= -1
    fov = math.degrees(2 * math.atan(18 / 50))
    frames = [{"camera_to_world": pose.flatten().tolist(), "fov": fov} for pose in poses]
    content = {
        "camera_path": [{**frame, "aspect": 4 / 3} for frame in frames],
        "keyframes": [],
        "camera_type": "perspective",
        "render_height": 36,
        "render_width": 48,
        "fps": 24,
        "seconds": 0.125,
        "is_cycle": False,
        "smoothness_value": 0.0,
    }
    return {**content, **changes}


def written(content: dict[str, Any], folder: Path) -> Path:
    path = folder / "path.json"
    path.write_text(json.dumps(content))
    return path


def test_nerfstudios_frames_are_its_cameras(tmp_path: Path):
    path = read_camera_path(written(nerfstudio(), tmp_path), CAMERAS)
    assert path.fps == 24 and path.cameras.size == (48, 36)
    assert torch.allclose(path.cameras.viewmats, CAMERAS.viewmats[:3], atol=1e-6)
    assert torch.allclose(path.cameras.Ks, CAMERAS.Ks[:3], atol=1e-4)
    assert read_camera_path(tmp_path / "path.json", CAMERAS, fps=12).fps == 12
    other = read_camera_path(written(nerfstudio(render_height=36.0), tmp_path), CAMERAS)
    assert other.cameras.size == (48, 36)
    with pytest.raises(StyleSplatError, match=r"holds every frame.*--fps"):
        read_camera_path(tmp_path / "path.json", CAMERAS, seconds=2)


def keys(*frames: dict[str, Any], **rest: Any) -> dict[str, Any]:
    return {"keyframes": [*frames], **rest}


def views(*rows: int) -> list[dict[str, Any]]:
    return [{"view": f"{row:04d}.jpg"} for row in rows]


def test_a_path_passes_its_key_frames_smoothly(tmp_path: Path):
    file = written(keys(*views(0, 1, 2, 3), seconds=2, fps=8.5), tmp_path)
    path = read_camera_path(file, CAMERAS).cameras
    assert len(path) == 17
    assert torch.allclose(path.viewmats[[0, -1]], CAMERAS.viewmats[[0, 3]], atol=1e-5)
    assert torch.allclose(path.Ks, CAMERAS.Ks[:1].expand_as(path.Ks), atol=1e-4)
    steps = path.positions[1:] - path.positions[:-1]
    assert (steps[1:] - steps[:-1]).norm(dim=1).max() < 0.2 * steps.norm(dim=1).mean()
    middle = path.viewmats @ torch.tensor([0.0, 0.0, 0.0, 1.0])
    assert middle[:, :2].abs().max() < 0.1, "between key frames it looks where they look"
    assert len(read_camera_path(file, CAMERAS, fps=10, seconds=4).cameras) == 40


def test_places_and_lenses_in_numbers(tmp_path: Path):
    eye = {"position": [0, -4, 2], "look_at": [0, 0, 0.5]}
    file = written(keys({**eye, "fov": 90}, {**eye, "fov": 30}, fps=1, seconds=3), tmp_path)
    path = read_camera_path(file, CAMERAS).cameras
    expected = look_at(torch.tensor([[0.0, -4.0, 2.0]]), torch.tensor([0, 0, 0.5]), UP)
    assert torch.allclose(path.viewmats, expected.expand_as(path.viewmats), atol=1e-5)
    lenses = 18 / torch.tan(torch.deg2rad(torch.tensor([45.0, 15.0])))
    assert torch.allclose(path.Ks[[0, 2], 1, 1], lenses, rtol=1e-5)
    assert torch.allclose(path.Ks[1, 1, 1], lenses.prod().sqrt(), rtol=1e-5)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (nerfstudio(camera_type="fisheye"), "fisheye"),
        (nerfstudio(camera_path=[{"camera_to_world": [0.0] * 16, "fov": 50}]), "frame 0"),
        (keys(*views(0, 1), seconds=1e4, fps=30), "Choose between 1 and 36,000"),
        (keys({"view": "cat"}, {"view": "dog"}), "'cat'"),
        (keys({"position": [0, 0, 1]}, *views(1)), "key frame 0 needs a view, or"),
        (keys({"position": [0, 0, 1], "look_at": [0, 0, 0]}, *views(1)), "straight up or down"),
        (keys({"view": "0000.jpg", "fov": 180}, *views(1)), "179"),
    ],
)
def test_files_that_are_no_path(content: dict[str, Any], match: str, tmp_path: Path):
    with pytest.raises(StyleSplatError, match=match):
        read_camera_path(written(content, tmp_path), CAMERAS)

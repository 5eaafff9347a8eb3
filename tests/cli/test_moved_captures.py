"""A scene finds its photos again, or says how to name their place."""

from dataclasses import replace
from pathlib import Path

import pytest

import stylesplat as ss
from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from processes import complaint, result
from stylesplat.io.json_files import read_json
from stylesplat.io.scene_folder import revise


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with a capture and a scene of it, two of whose views are held out."""
    capture = write_ball_capture(tmp_path / "project/capture")
    scene = ss.Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:2], capture=capture)
    ss.save(scene, tmp_path / "project/scenes/balls")
    return tmp_path / "project"


def test_both_are_moved_together(project: Path, capsys: pytest.CaptureFixture[str]):
    moved = project.rename(project.with_name("elsewhere"))
    scene = ss.open(moved / "scenes/balls")
    assert scene.capture == moved / "capture"
    assert result(capsys, "evaluate", moved / "scenes/balls")["psnr"] > 30
    ss.save(scene, moved / "copy")
    assert read_json(moved / "copy/scene.json")["capture"] == str(moved / "capture")
    assert read_json(moved / "copy/scene.json")["capture_relative"] == "../capture"


def test_a_changed_scene_keeps_its_way_there(project: Path):
    folder = project / "scenes/balls"
    before = ss.open(folder)
    revise(before, replace(before, info={"more": 1}), folder)
    moved = project.rename(project.with_name("elsewhere"))
    assert ss.open(moved / "scenes/balls").capture == moved / "capture"
    assert ss.open(moved / "scenes/balls").info == {"more": 1}


def test_photos_that_are_gone_are_asked_for(project: Path, tmp_path: Path, capsys):
    gone = project / "capture"
    moved = gone.rename(tmp_path / "garden")
    line = complaint(capsys, "evaluate", project / "scenes/balls")
    assert f"no longer in {gone}" in line and "--capture" in line
    numbers = result(capsys, "evaluate", project / "scenes/balls", "--capture", moved)
    assert numbers["psnr"] > 30


def test_held_out_photos_may_be_missing(project: Path, capsys: pytest.CaptureFixture[str]):
    scene, photos = project / "scenes/balls", project / "capture/images"
    whole = result(capsys, "evaluate", scene)
    (photos / CAMERAS.names[0]).unlink()
    assert result(capsys, "evaluate", scene)["psnr"] != whole["psnr"]
    (photos / CAMERAS.names[1]).unlink()
    assert "None of the 2 held-out photos" in complaint(capsys, "evaluate", scene)

"""`stylesplat mask` and `objects` of a scene that came without photos."""

import os
from pathlib import Path

import pytest

from balls import BALLS, BARE, agreement, around
from processes import as_nobody, complaint, public_folder, result, run
from stylesplat.io import scene_folder


def test_as_it_is_typed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder, other = tmp_path / "scene", tmp_path / "other"
    scene_folder.save(BARE, folder)
    before = result(capsys, "objects", folder)
    assert before["objects"] == [] and before["sheet"] is None
    assert before["content"]["size"][2] == pytest.approx(0.7, abs=0.15)
    box = "red=view_004:" + ",".join(map(str, around(3, "view_004")[1]))
    found = result(capsys, "mask", folder, "--box", box, "-o", other, "--device", "cpu")
    assert found["names"] == {"1": "red"} and found["of"] == 36
    assert (other / "masks.jpg").is_file() and str(other) == found["scene"]
    assert scene_folder.open(folder).splats.classifier is None, "left as it was"
    assert agreement(scene_folder.open(other).objects["red"].picked, 3) > 0.8
    listed = result(capsys, "objects", other)
    (red,) = listed["objects"]
    assert listed["named"]["red"] == {
        key: red[key] for key in ("gaussians", "box", "centre", "size")
    }
    assert red["centre"] == pytest.approx(BALLS[3][0], abs=0.1)
    corners = ",".join(map(str, red["box"]))
    again = result(capsys, "select", other, "--name", "again", f"--box3d={corners}")
    assert again["gaussians"] > 60
    refused = complaint(capsys, "mask", other, "--from", tmp_path)
    assert "would replace. Pass --overwrite" in refused
    assert "means nothing" in complaint(capsys, "mask", other, "--box", box, "--scene", other)
    assert "--overwrite" in complaint(capsys, "mask", folder, "--box", box, "-o", other)


BOX = "red=view_004:" + ",".join(map(str, around(3, "view_004")[1]))


@pytest.mark.skipif(os.getuid() != 0, reason="gives its rights away for a while")
def test_scenes_of_others_are_refused_before_the_work(monkeypatch, capsys):
    monkeypatch.setattr("stylesplat.mask", lambda *_, **__: pytest.fail("works"))
    with public_folder() as folder:
        scene_folder.save(BARE, folder / "scene")
        with as_nobody():
            line = complaint(capsys, "mask", folder / "scene", "--box", BOX)
    assert "Permission denied. Choose a place that this user may write to." in line


def test_pictures_of_what_a_name_no_longer_means_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = tmp_path / "scene"
    scene_folder.save(BARE, folder)
    pictures = {}
    for name, x in (("red", 0), ("blue", 1)):
        found = result(capsys, "select", folder, "--name", name, f"--sphere={x},0,0,1")
        pictures[name] = Path(found["picture"])
    box = "red=view_004:" + ",".join(map(str, around(3, "view_004")[1]))
    assert run("mask", folder, "--box", box, "--device", "cpu") == 0
    assert f"Picture: {folder / 'masks.jpg'}" in capsys.readouterr().err
    assert not pictures["red"].exists() and pictures["blue"].is_file()

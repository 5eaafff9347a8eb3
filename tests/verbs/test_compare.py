"""Scenes side by side: the same views, numbers, differences; a scene differs from itself by 0."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.summary import flat
from stylesplat.io.captures.capture_folder import load
from stylesplat.scene.frames import Frame, move_cameras
from stylesplat.scene.scene import Scene, shared_views
from stylesplat.verbs.adjust import recolor
from stylesplat.verbs.evaluate import compare
from stylesplat.verbs.select import select

SCENE = Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:2])
DARKER = replace(SCENE, base=replace(SPLATS, sh0=SPLATS.sh0 - 0.5))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ball_capture(tmp_path_factory.mktemp("capture"))


def test_a_scene_against_itself_is_zero_everywhere(folder: Path):
    capture = load(folder)
    found = compare({"a": SCENE, "b": SCENE}, {"a": capture, "b": capture}, device="cpu")
    for each in found.scenes:
        gaps = dict(flat(each.differences))
        assert gaps.keys() == dict(flat(each.metrics)).keys() and "psnr" in gaps
        assert {*gaps.values()} == {0}
        assert len(each.from_first) == 4
        assert [*each.from_first.values()] == pytest.approx([0, 0, 0, 0], abs=1e-6)  # SSIM's float
    assert found.views == CAMERAS.names[:2] and not found.notes


def test_differences_are_to_the_first(folder: Path):
    capture = load(folder)
    found = compare({"a": SCENE, "b": DARKER}, {"a": capture, "b": capture}, device="cpu")
    a, b = found.scenes
    assert b.differences["psnr"] == b.metrics["psnr"] - a.metrics["psnr"] < -3
    assert b.differences["iou"] == {3: 0, 7: 0, 300: 0}, "labels are the same"
    assert b.from_first["changed_share"] > 0.1 and b.from_first["ssim_lost"] > 0
    summary = found.summary()
    assert summary["schema"] == "stylesplat-comparison-1"
    assert [each["name"] for each in summary["scenes"]] == ["a", "b"]


def test_what_cannot_be_measured_is_looked_at(folder: Path):
    found = compare({"a": SCENE, "b": DARKER}, {"a": load(folder)}, device="cpu")
    _, b = found.scenes
    assert not b.metrics and not b.differences and b.from_first["mean_difference"] > 0
    assert found.notes[0].startswith("b has no numbers: Nothing to compare")


def test_a_line_says_that_photos_show_no_paint(folder: Path):
    capture = load(folder)
    painted = recolor(select(SCENE, "red", id=3), "red", hue=90.0)
    found = compare({"a": SCENE, "b": painted}, {"a": capture, "b": capture}, device="cpu")
    (note,) = found.notes
    assert note.startswith("b is painted, and its photos are not")


def test_the_frame_of_the_world_is_immaterial():
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = replace(SCENE, cameras=move_cameras(CAMERAS, Frame(turn, 2.0, torch.ones(3))))
    assert shared_views({"a": SCENE, "b": moved}) == CAMERAS.names[:2]


def test_scenes_that_cannot_be_compared():
    few, rest = (replace(SCENE, cameras=CAMERAS[rows]) for rows in ([0, 1], [2, 3]))
    for scenes, message in (
        ({"a": SCENE}, r"at least two scenes to compare, got 1\."),
        ({"all": SCENE, "b": few, "c": rest}, r"No view is in all of all, b, c; 0000\.jpg"),
        (
            {"a": SCENE, "b": replace(SCENE, cameras=CAMERAS.downscale(2))},
            r"is 48x36 pixels in a and 24x18 in b\.",
        ),
    ):
        with pytest.raises(StyleSplatError, match=message):
            compare(scenes)

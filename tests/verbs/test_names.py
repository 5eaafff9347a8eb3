"""Names that label maps bring along: objects of scenes made with them have these names."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from ball_photos import write_ball_capture
from balls import CAMERAS, SPLATS
from stylesplat.verbs.export import export
from stylesplat.io.label_maps import write_names
from stylesplat.io.scene_folder import Scene, read_scene
from stylesplat.selection.pick import pick
from stylesplat.training.train_config import TrainConfig
from stylesplat.verbs.import_splat import import_splat
from stylesplat.verbs.objects import can_be_called, find_object, list_objects, with_names
from stylesplat.verbs.train import train_scene

PLAIN = replace(SPLATS, identities=None, classifier=None)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = write_ball_capture(tmp_path / "capture")
    write_names({7: "vase", 300: "3"}, folder / "object_mask")
    return folder


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    export(PLAIN, tmp_path / "splat.ply")
    return tmp_path / "splat.ply"


def check_names(folder: Path, said: str) -> None:
    scene = read_scene(folder)
    assert [*scene.picks] == ["vase"] and scene.picks["vase"].any()
    assert torch.equal(scene.picks["vase"], pick(scene.splats, object_id=7))
    assert torch.equal(find_object(scene, "vase"), find_object(scene, "7"))
    how = json.loads((folder / "objects.json").read_text())["vase"]
    assert how["ids"] == [7] and how["gaussians"] == scene.picks["vase"].sum()
    names = {each["id"]: each["names"] for each in list_objects(folder)["objects"]}
    assert names == {3: [], 7: ["vase"], 300: []}
    assert "Object 300 is not called '3'. `stylesplat select` names it." in said


def test_an_imported_splat(capture: Path, splat: Path, tmp_path: Path, said: list[str]):
    import_splat(splat, tmp_path / "scene", capture_path=capture, device="cpu")
    check_names(tmp_path / "scene", "\n".join(said))


def test_a_trained_scene(capture: Path, tmp_path: Path, said: list[str]):
    config = TrainConfig(steps=100, max_gaussians=1000)
    train_scene(capture, tmp_path / "scene", config=config, segment="lift", device="cpu")
    check_names(tmp_path / "scene", "\n".join(said))


def test_a_scene_without_objects_needs_no_names():
    plain = Scene(PLAIN, CAMERAS)
    named = with_names(plain, {3: "vase"})
    assert named.picks == {} and named.objects == {}


def test_names_of_nothing_are_left_out(said: list[str]):
    named = with_names(Scene(SPLATS, CAMERAS), {0: "background", 3: "vase", 99: "lost"})
    assert [*named.picks] == ["vase"]
    assert said == [], "no photo shows what no label map has"


def test_a_name_of_two_objects_is_that_of_the_first(said: list[str]):
    named = with_names(Scene(SPLATS, CAMERAS), {3: "cup", 7: "cup"})
    assert named.objects["cup"]["ids"] == [3]
    assert "Object 7 is not called 'cup'" in "\n".join(said)


def test_names_that_can_be_and_cannot():
    assert all(map(can_be_called, ("vase", "vase 2", "2nd", "花瓶", "-3")))
    assert not any(map(can_be_called, ("", "3", "007", "a=b")))

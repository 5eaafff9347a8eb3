"""Names that label maps bring along: objects of scenes made with them have these names."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from stylesplat.io import scene_folder
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.label_maps import write_names
from stylesplat.scene.scene import Scene
from stylesplat.selection.labels import pick
from stylesplat.selection.resolve import find_object
from stylesplat.verbs.import_ import import_
from stylesplat.verbs.objects import objects

PLAIN = replace(SPLATS, identities=None, classifier=None)
SCENE = Scene(SPLATS, CAMERAS)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = write_ball_capture(tmp_path / "capture")
    write_names({7: "vase", 300: "3"}, folder / "object_mask")
    return folder


def test_an_imported_splat(capture: Path, tmp_path: Path, said: list[str]):
    folder = tmp_path / "scene"
    scene_folder.save(import_(PLAIN, load(capture), device="cpu"), folder)
    scene = scene_folder.open(folder)
    assert [*scene.objects] == ["vase"] and scene.objects["vase"].mask.any()
    assert torch.equal(scene.objects["vase"].mask, pick(scene.splats, object_id=7))
    assert torch.equal(find_object(scene, "vase"), find_object(scene, "7"))
    how = json.loads((folder / "objects.json").read_text())["vase"]
    assert how["ids"] == [7] and how["gaussians"] == scene.objects["vase"].mask.sum()
    names = {each["id"]: each["names"] for each in objects(scene)}
    assert names == {3: [], 7: ["vase"], 300: []}
    assert "Object 300 does not get the name '3'" in "\n".join(said)

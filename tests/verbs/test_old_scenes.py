"""Scenes of format 1 open as they look; what was painted in them cannot be undone."""

import json
import shutil
from pathlib import Path

import pytest
from safetensors.torch import save_file

from balls import SPLATS, TRAINED, assert_same_splats, contents, opened, painted
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.scene.scene import Scene
from stylesplat.stylization.recipe import read_recipe
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.objects import delete

pytestmark = pytest.mark.usefixtures("quick_painting")


def as_of_old(folder: Path) -> None:
    """Turn a painted scene on disk into what earlier versions wrote."""
    scene = scene_folder.open(folder)
    info = json.loads((folder / "scene.json").read_text())
    (folder / "scene.json").write_text(json.dumps({**info, "version": 1}))
    shutil.rmtree(folder / "layers", ignore_errors=True)
    (folder / "base.ply").unlink(missing_ok=True)
    if not scene.layers:
        return
    (folder / "layers.json").unlink()
    looks = {"sh0": scene.splats.sh0, "shN": scene.splats.shN}
    for name in ("base_colors", "style_colors"):
        save_file(looks, folder / f"{name}.safetensors")
    save_file({"0": scene.to_splats(scene.objects["red"].mask)}, folder / "paintings.safetensors")
    recipe = json.loads((folder / "recipe.json").read_text())
    entry = {**recipe["objects"][0], "upon": {"green": 0.5}}
    gone = [{**entry, "name": "green", "place": 0}]
    content = {**recipe, "objects": [entry], "gone": gone, "scene": str(folder), "weights": None}
    (folder / "recipe.json").write_text(json.dumps(content))


@pytest.fixture
def old(stack: Path, tmp_path: Path) -> tuple[Path, Scene]:
    """A painted scene of old on disk, and as it is."""
    as_of_old(shutil.copytree(stack / "once", tmp_path / "old"))
    return tmp_path / "old", opened(stack / "once")


def test_a_painted_scene_of_old_opens_as_it_looks(old: tuple[Path, Scene], said: list[str]):
    folder, scene = old
    (folder / "base_colors.safetensors").write_bytes(b"")  # damaged, but of no use
    found = scene_folder.open(folder)
    assert sum("cannot be undone" in line for line in said) == 1
    assert len(found.splats) > len(SPLATS)
    assert_same_splats(found.splats, scene.splats)
    assert found.layers == () and found.objects.keys() == PICKED
    with pytest.raises(StyleSplatError, match="is not styled"):
        adjust(found, undo=True)
    recipe = read_recipe(folder / "recipe.json")
    assert [(each.name, each.features) for each in recipe.objects] == [("red", "compact")]
    assert any("is ignored" in line for line in said)


PICKED = {"red", "green", "blue", "both"}


def test_a_scene_of_old_is_painted_on_and_written_anew(old: tuple[Path, Scene], stack: Path):
    folder, _ = old
    found = scene_folder.open(folder)
    again = painted(found, "green", stack / "night.png", quality="draft", measured=False)
    scene_folder.revise(found, again, folder)
    scene_folder.save(again, folder.parent / "new")
    assert contents(folder) == contents(folder.parent / "new"), "nothing of old is left"
    undone = adjust(opened(folder), undo=True)
    assert_same_splats(undone.splats, found.splats)


def test_any_change_of_a_scene_of_old_makes_it_a_new_one(tmp_path: Path, said: list[str]):
    scene_folder.save(TRAINED, tmp_path / "old")
    as_of_old(tmp_path / "old")
    found = scene_folder.open(tmp_path / "old")
    assert not said, "of one that was never painted there is nothing to tell"
    scene_folder.revise(found, delete(found, "red"), tmp_path / "old")
    assert json.loads((tmp_path / "old/scene.json").read_text())["version"] == 2
    assert opened(tmp_path / "old").objects.keys() == PICKED - {"red"}

"""The verbs `rename` and `delete`."""

from dataclasses import fields, replace
from pathlib import Path

import pytest

from balls import CAMERAS, SPLATS, assert_same_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.json_yaml import read_json
from stylesplat.scene.scene import Scene
from stylesplat.selection.resolve import find_object
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.objects import delete, rename
from stylesplat.verbs.select import select

SCENE = select(select(Scene(SPLATS, CAMERAS), "red", id=3), "green", id=7)


@pytest.fixture
def styled(stack: Path) -> Scene:
    return scene_folder.open(stack / "once")


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("blue", "it", r"No object of the scene is called 'blue'\. Names: red, green\."),
        ("red", "green", r"something else is called 'green'"),
        ("red", "red", r"^'red' is called so already\."),
        ("red", "7", r"numbers are label ids"),
    ],
)
def test_names_that_cannot_be_given(old: str, new: str, fault: str):
    with pytest.raises(StyleSplatError, match=fault):
        rename(SCENE, old, new)


def test_an_object_is_forgotten():
    scene = delete(SCENE, "red")
    assert [*scene.objects] == ["green"] and scene.splats is SCENE.splats
    same = replace(scene, objects=SCENE.objects)
    assert all(getattr(same, each.name) is getattr(SCENE, each.name) for each in fields(Scene))
    with pytest.raises(StyleSplatError, match=r"is called 'red'\. Names: green\."):
        delete(scene, "red")
    with pytest.raises(StyleSplatError, match=r"Names: none\."):
        delete(delete(scene, "green"), "green")


def test_the_layer_of_what_is_renamed_is_renamed_too(styled: Scene, tmp_path: Path):
    """So that what is painted on it later takes its place, and the recipe knows it."""
    other = rename(styled, "red", "vase")
    assert other.painted_objects == ("vase",)
    assert_same_splats(other.splats, styled.splats)
    scene_folder.save(styled, tmp_path / "scene")
    scene_folder.revise(styled, other, tmp_path / "scene")
    found = scene_folder.open(tmp_path / "scene")
    assert found.painted_objects == ("vase",) and "vase" in found.objects
    assert read_json(tmp_path / "scene/recipe.json")["objects"][0]["name"] == "vase"
    assert [path.name for path in (tmp_path / "scene/layers").iterdir()] == ["01-vase.safetensors"]
    assert_same_splats(adjust(found, 0.2).splats, adjust(styled, 0.2).splats)
    undone = adjust(found, objects="vase", undo=True)
    assert_same_splats(undone.splats, adjust(styled, undo=True).splats)
    with pytest.raises(StyleSplatError, match="something else is called 'red'"):
        rename(delete(styled, "red"), "green", "red")


def test_what_is_painted_stays_so_without_a_name(styled: Scene, tmp_path: Path, said: list[str]):
    scene = delete(styled, "red")
    assert f"`stylesplat adjust {styled.path} --object red --undo -o OTHER`" in said[-1]
    assert_same_splats(scene.splats, styled.splats)
    undone = adjust(scene, objects="red", undo=True)
    assert_same_splats(undone.splats, adjust(styled, undo=True).splats)
    assert undone.objects.keys() == {"green", "blue", "both"}
    place = tmp_path / "my garden"
    with pytest.raises(StyleSplatError, match=rf"`stylesplat select '{place}' --name NAME --id N`"):
        find_object(replace(scene, path=place), "lid")

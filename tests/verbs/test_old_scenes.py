"""Styled scenes that StyleSplat 1 wrote still open, and can be adjusted and undone."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load, save

from painted_balls import (
    FAST,
    TRAINED,
    assert_same_splats,
    painted,
    write_pictures,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.json_files import read_json, write_json
from stylesplat.scene.paintings import Painted
from stylesplat.scene.scene import Scene
from stylesplat.stylization.recipe import read_recipe
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_pictures(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "trained"
    scene_folder.save(TRAINED, folder)
    return folder


def paint_of(scene: Scene) -> Painted:
    assert scene.painted is not None
    return scene.painted


def as_of_old(folder: Path) -> None:
    """Turn a styled scene on disk into what StyleSplat 1 wrote.

    It had no `paintings.safetensors`: names of what was painted lay in `picks.safetensors`, label
    ids among them; and one network for all in `recipe.json`, without digests and without what was
    painted upon what.
    """
    scene, content = scene_folder.open(folder), read_json(folder / "recipe.json")
    picks = load((folder / "picks.safetensors").read_bytes())
    for each in paint_of(scene).paintings:
        picks.setdefault(each.name, each.picked)
    (folder / "picks.safetensors").write_bytes(save(picks))
    (folder / "paintings.safetensors").unlink()
    kept = ("name", "style", "sha256", "intensity", "settings")
    content["objects"] = [{key: each[key] for key in kept} for each in content["objects"]]
    write_json(content, folder / "recipe.json")


@pytest.fixture
def old(trained: Path, pictures: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Scene]:
    """A scene of old on disk, and what it was made from; one object was painted by its id."""
    scene = painted(scene_folder.open(trained), "3", pictures[0])
    scene = painted(scene, "green", pictures)
    scene_folder.save(scene, tmp_path / "old")
    as_of_old(tmp_path / "old")
    return tmp_path / "old", scene


def test_styled_scenes_of_old_are_adjusted_and_undone(
    old: tuple[Path, Scene], trained: Path, tmp_path: Path
):
    folder, scene = old
    found = scene_folder.open(folder)
    assert found.objects.keys() == TRAINED.objects.keys(), "an id is no name"
    assert paint_of(found).names == ("3", "green")
    for mine, its in zip(paint_of(found).paintings, paint_of(scene).paintings, strict=True):
        assert torch.equal(mine.picked, its.picked)
        assert (mine.styles, mine.settings) == (its.styles, its.settings)
    adjusted = adjust(found, 1.1, objects="3")
    assert_same_splats(adjusted.splats, adjust(scene, 1.1, objects="3").splats)
    scene_folder.revise(found, adjusted, folder)
    again = scene_folder.open(folder)
    assert_same_splats(adjust(again, FAST.intensity).splats, scene.splats)
    undone = adjust(again, undo=True)
    scene_folder.revise(again, undone, folder)
    for path in trained.iterdir():
        assert (folder / path.name).read_bytes() == path.read_bytes(), path.name
    assert {path.name for path in folder.iterdir()} == {path.name for path in trained.iterdir()}


def test_styled_scenes_of_old_are_measured_and_undone_one_by_one(
    old: tuple[Path, Scene], pictures: tuple[Path, Path]
):
    folder, scene = old
    found = scene_folder.open(folder)
    assert evaluate(found, device="cpu") == evaluate(scene, device="cpu")
    with pytest.raises(StyleSplatError, match="red is styled in"):
        painted(found, "red", pictures[0])
    undone = adjust(found, objects="3", undo=True)
    assert_same_splats(undone.splats, adjust(scene, objects="3", undo=True).splats)
    assert paint_of(painted(found, "blue", pictures[0])).names == ("3", "green", "blue")


def test_the_recipe_of_a_scene_of_old_is_one(old: tuple[Path, Scene], trained: Path):
    found = read_recipe(old[0] / "recipe.json")
    assert [each.name for each in found.objects] == ["3", "green"]
    assert all(each.upon is None and each.features == "compact" for each in found.objects)
    again = stylize(scene_folder.open(trained), found, device="cpu")
    assert paint_of(again).names == ("3", "green")


def test_a_scene_of_old_whose_picks_are_lost(old: tuple[Path, Scene]):
    folder, _ = old
    picks = load((folder / "picks.safetensors").read_bytes())
    del picks["3"]
    (folder / "picks.safetensors").write_bytes(save(picks))
    with pytest.raises(StyleSplatError, match=r"recipe\.json: it does not say what was painted"):
        scene_folder.open(folder)

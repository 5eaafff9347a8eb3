"""Paintings taken back one by one, and objects painted anew, beside others that stay."""

from pathlib import Path

import pytest
import torch

from balls import SPLATS
from painted_balls import (
    FAST,
    TRAINED,
    assert_same_objects,
    assert_same_splats,
    opened,
    paint_of,
    painted,
    write_painted,
)
from painted_balls import contents as all_contents
from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import read_json
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene
from stylesplat.selection.pick import pick
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Recipe, Style, StyledObject
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.delete import delete
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The balls; red painted; green painted upon that, by its label id; and two pictures."""
    return write_painted(tmp_path_factory.mktemp("undo"), "7", lambda wave, night: night)


def contents(folder: Path) -> dict[str, bytes]:
    return all_contents(folder, "metrics.json")


def of(scene: Scene, name: str) -> torch.Tensor:
    """The Gaussians of a painting."""
    (found,) = (each.picked for each in paint_of(scene).paintings if each.name == name)
    return found


def assert_made_again(scene: Scene, folder: Path, place: Path) -> None:
    """From the scene before, by the recipe: every file but that of what was measured."""
    save(scene, place / "it")
    recipe = read_recipe(place / "it" / "recipe.json")
    save(stylize(opened(folder / "trained"), recipe, device="cpu"), place / "again")
    assert contents(place / "again") == contents(place / "it")


def test_undoing_the_last_gives_the_scene_before_it(folder: Path, tmp_path: Path):
    twice = opened(folder / "twice")
    assert len(twice.splats) > len(opened(folder / "once").splats) > len(SPLATS)
    undone = adjust(adjust(twice, 0.2, objects="7"), objects="7", undo=True)
    save(undone, tmp_path / "undone")
    assert contents(tmp_path / "undone") == contents(folder / "once")
    assert undone.metrics == {"train": {"psnr": 30.0}}


def test_undoing_the_first_leaves_the_second_alone(folder: Path, tmp_path: Path):
    twice, trained = opened(folder / "twice"), opened(folder / "trained")
    save(adjust(twice, undo=True, objects=["red"]), tmp_path / "undone")
    undone = opened(tmp_path / "undone")
    first = torch.arange(len(SPLATS))
    others = ~of(twice, "7")[first]
    assert_same_splats(undone.splats[first][others], trained.splats[others])
    assert_same_splats(undone.splats[of(undone, "7")], twice.splats[of(twice, "7")])
    assert len(undone.splats) - len(SPLATS) == (~first_ones(undone) & of(undone, "7")).sum()
    assert paint_of(undone).names == ("7",)
    assert undone.objects.keys() == TRAINED.objects.keys()


def first_ones(scene: Scene) -> torch.Tensor:
    """Those that the scene had before anything was split."""
    return torch.arange(len(scene.splats)) < len(SPLATS)


@pytest.mark.parametrize("order", [("red", "7"), ("7", "red")])
def test_undoing_one_after_the_other_is_undoing_all(
    order: tuple[str, str], folder: Path, tmp_path: Path
):
    scene = opened(folder / "twice")
    for number, name in enumerate(order):
        save(adjust(scene, objects=name, undo=True), tmp_path / str(number))
        scene = opened(tmp_path / str(number))
    assert contents(tmp_path / "1") == contents(folder / "trained")
    both = adjust(opened(folder / "twice"), objects=order, undo=True)
    assert both.painted is None and both.metrics == {"psnr": 30.0}
    assert_same_splats(both.splats, opened(folder / "trained").splats)


def test_what_is_left_is_adjusted_measured_and_made_again(folder: Path, tmp_path: Path):
    """Also of what was painted upon something that is gone."""
    undone = adjust(opened(folder / "twice"), objects="red", undo=True)
    assert [each.painting.name for each in paint_of(undone).gone] == ["red"]
    assert_made_again(undone, folder, tmp_path)
    loud = adjust(opened(tmp_path / "it"), 1.2)
    assert_same_splats(adjust(loud, FAST.intensity).splats, undone.splats)
    assert evaluate(loud, device="cpu")["nnfm_after"].keys() == {"7"}
    recipe = read_json(tmp_path / "it" / "recipe.json")
    assert [each["name"] for each in recipe["objects"]] == ["7"]
    assert [(each["name"], each["place"]) for each in recipe["gone"]] == [("red", 0)]


def test_only_what_others_were_painted_upon_is_remembered(folder: Path, tmp_path: Path):
    wave, night = folder / "wave.png", folder / "night.png"
    styles = {"red": Style(wave, config=FAST), "green": Style(night, config=FAST)}
    both = stylize(opened(folder / "trained"), styles, device="cpu")
    assert paint_of(adjust(both, objects="red", undo=True)).gone == ()
    scene = painted(both, "blue", wave)
    scene = adjust(scene, objects="red", undo=True)
    assert [(each.painting.name, each.place) for each in paint_of(scene).gone] == [("red", 0)]
    assert_made_again(scene, folder, tmp_path)
    assert paint_of(adjust(scene, objects="blue", undo=True)).gone == ()


def test_what_is_not_painted_is_not_undone(folder: Path):
    with pytest.raises(StyleSplatError, match=r"blue is not styled in .*Styled objects: red, 7"):
        adjust(opened(folder / "twice"), objects=["red", "blue"], undo=True)


def test_an_object_is_painted_anew_from_its_own_colours(folder: Path, said: list[str]):
    """Not upon its old style; the only one that was painted gives what painting it first does."""
    night = folder / "night.png"
    anew = painted(opened(folder / "once"), "red", night)
    assert "Painting red anew, from the colours before." in said
    first = painted(opened(folder / "trained"), "red", night)
    assert_same_splats(anew.splats, first.splats)
    assert_same_objects(anew, first)
    assert paint_of(anew).origin == folder / "trained"
    assert anew.metrics["train"] == {"psnr": 30.0}


def test_painting_one_anew_leaves_the_others_alone(folder: Path, tmp_path: Path):
    twice = adjust(opened(folder / "twice"), 0.3, objects="7")
    anew = painted(twice, "red", folder / "night.png", max_growth=2.0)
    assert paint_of(anew).names == ("7", "red")
    assert_same_splats(anew.splats[of(anew, "7")], twice.splats[of(twice, "7")])
    first = torch.arange(len(SPLATS))
    others = ~(of(twice, "7") | of(twice, "red"))[first]
    assert_same_splats(anew.splats[first][others], twice.splats[first][others])
    assert (anew.splats.sh0[of(anew, "red")][:80] != twice.splats.sh0[of(twice, "red")][:80]).any()
    assert [dict(each.upon) for each in paint_of(anew).paintings] == [
        {"red": 0.6},
        {"7": 0.3},
    ]
    assert_made_again(anew, folder, tmp_path)
    undone = adjust(opened(tmp_path / "it"), undo=True)
    assert_same_splats(undone.splats, opened(folder / "trained").splats)
    again = adjust(opened(tmp_path / "it"), objects="red", undo=True)
    assert_same_splats(again.splats[of(again, "7")], twice.splats[of(twice, "7")])


def test_an_object_is_painted_anew_by_its_id_and_several_at_once(folder: Path):
    night = folder / "night.png"
    styles = {"7": Style(night, config=FAST), "red": Style(night, config=FAST)}
    anew = stylize(opened(folder / "twice"), styles, device="cpu")
    first = stylize(opened(folder / "trained"), styles, device="cpu")
    assert_same_splats(anew.splats, first.splats)
    assert paint_of(anew).gone == () and paint_of(anew).names == ("7", "red")


def test_a_part_of_what_is_painted_is_not_painted(folder: Path):
    both = select(opened(folder / "twice"), "either", plus=("red", "7"))
    with pytest.raises(StyleSplatError, match=r"either is styled in .*as a part of red\. .*--undo"):
        painted(both, "either", folder / "wave.png")
    assert pick(both.splats, object_id=3).any()
    with pytest.raises(StyleSplatError, match=r"3 is styled in .* as a part of red"):
        painted(both, "3", folder / "wave.png")


def test_names_are_known_before_anything_is_cleared_or_painted(folder: Path, said: list[str]):
    """Also those of later runs, whose mistakes would else come after minutes."""
    night = folder / "night.png"
    nameless = delete(opened(folder / "once"), "red")
    said.clear()
    with pytest.raises(StyleSplatError, match=r"no object 'red'.*`stylesplat select \S*once "):
        painted(nameless, "red", night)
    assert not said
    style = Style(night, config=FAST)
    for later, fault in (("lid", "no object 'lid'"), ("both", "red and both at once")):
        objects = StyledObject("red", style), StyledObject(later, style, upon={"red": 1.0})
        with pytest.raises(StyleSplatError, match=fault):
            stylize(opened(folder / "trained"), Recipe(objects), device="cpu")
        assert not said, "not even the first is begun"


@pytest.mark.parametrize("first", ["red", "green"])
def test_one_after_the_other_gives_what_was_before_both(folder: Path, first: str):
    """Without a folder in between, as in a program; each has Gaussians that were split."""
    trained, style = opened(folder / "trained"), Style(folder / "night.png", config=FAST)
    both = stylize(trained, {"red": style, "green": style}, device="cpu")
    assert paint_of(both).unsplit is not None
    other = "green" if first == "red" else "red"
    one = adjust(both, objects=first, undo=True)
    gone = adjust(one, objects=other, undo=True)
    assert gone.painted is None
    for name, tensor in trained.splats.tensors().items():
        assert torch.equal(gone.splats.tensors()[name], tensor), name
    for looks in (paint_of(one).before, paint_of(one).full):
        mine = trained.objects[first].picked
        assert torch.equal(looks.opacities[: len(mine)][mine], trained.splats.opacities[mine])


def test_nothing_is_told_of_what_is_painted_only_in_passing(folder: Path, tmp_path: Path):
    """Be it painted before what stays, or with it."""
    night, wave = folder / "night.png", folder / "wave.png"
    save(adjust(opened(folder / "twice"), objects="red", undo=True), tmp_path / "alone")
    styles = {"red": Style(wave, config=FAST), "green": Style(night, config=FAST)}
    two = stylize(opened(folder / "trained"), styles, device="cpu")
    three = painted(two, "blue", wave)
    save(adjust(three, objects="red", undo=True), tmp_path / "among")
    for place, names in (("alone", {"7"}), ("among", {"green", "blue"})):
        recipe = read_recipe(tmp_path / place / "recipe.json")
        assert [each.name for each in recipe.objects if each.gone] == ["red"]
        again = stylize(opened(folder / "trained"), recipe, device="cpu")
        numbers = again.metrics
        by_object = {key: each for key, each in numbers.items() if isinstance(each, dict)}
        del by_object["train"]
        assert {"seconds_by_object", "nnfm_after"} <= by_object.keys()
        assert all(each.keys() <= names for each in by_object.values()), by_object
        assert numbers["steps"] == FAST.all_steps * len(names)
        assert numbers["changed_outside"] == 0
        assert numbers["painted_gaussians"] <= 80 * len(names)
        assert numbers["changed_gaussians"] == _changed(again, opened(folder / "trained"))


def _changed(scene: Scene, before: Scene) -> int:
    """How many Gaussians are not as they were, new ones included."""
    first, count = scene.splats, len(before.splats)
    differ = torch.zeros(count, dtype=torch.bool)
    for name, tensor in before.splats.tensors().items():
        if tensor.numel():
            pairs = (first.tensors()[name][:count] != tensor).reshape(count, -1)
            differ |= pairs.any(dim=1)
    return int(differ.sum()) + len(first) - count

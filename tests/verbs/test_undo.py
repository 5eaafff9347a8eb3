"""Paintings taken back one by one, and objects painted anew, beside others that stay."""

from pathlib import Path

import pytest
import torch

from balls import PAINTED_FAST as FAST
from balls import (
    SPLATS,
    TRAINED,
    assert_same_objects,
    assert_same_splats,
    opened,
    own_rows,
    painted,
    write_painted,
)
from balls import contents as all_contents
from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import read_json
from stylesplat.io.scene_folder import save
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.objects import delete
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize, stylize_unmeasured

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The balls; red painted; green painted upon that, by its label id; and two pictures."""
    return write_painted(tmp_path_factory.mktemp("undo"), "7", lambda wave, night: night)


def contents(folder: Path) -> dict[str, bytes]:
    return all_contents(folder, "metrics.json")


def test_undoing_the_last_gives_the_scene_before_it(folder: Path, tmp_path: Path):
    twice = opened(folder / "twice")
    assert len(twice.splats) == len(opened(folder / "once").splats) > len(SPLATS)
    undone = adjust(adjust(twice, 0.2, objects="7"), objects="7", undo=True)
    save(undone, tmp_path / "undone")
    assert contents(tmp_path / "undone") == contents(folder / "once")
    assert undone.metrics == {"train": {"psnr": 30.0}}


def test_undoing_the_first_leaves_the_second_alone(folder: Path, tmp_path: Path):
    twice, trained = opened(folder / "twice"), opened(folder / "trained")
    save(adjust(twice, undo=True, objects=["red"]), tmp_path / "undone")
    undone = opened(tmp_path / "undone")
    others = ~own_rows(undone, "7")
    assert_same_splats(undone.splats[others], trained.splats[others])
    mine = own_rows(twice, "7")
    assert_same_splats(undone.splats[~others], twice.splats[mine])
    assert undone.painted_objects == ("7",)
    assert undone.objects.keys() == TRAINED.objects.keys()
    layers = [
        (folder / "twice/layers/02-7.safetensors"),
        tmp_path / "undone/layers/01-7.safetensors",
    ]
    assert layers[0].read_bytes() == layers[1].read_bytes(), "it keeps its bytes"


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
    assert not both.layers and both.base is None and both.metrics == {"psnr": 30.0}
    assert_same_splats(both.splats, opened(folder / "trained").splats)


def test_what_is_left_is_adjusted_and_measured(folder: Path, tmp_path: Path):
    undone = adjust(opened(folder / "twice"), objects="red", undo=True)
    loud = adjust(undone, 1.2)
    assert_same_splats(adjust(loud, FAST.intensity).splats, undone.splats)
    assert evaluate(loud, device="cpu")["nnfm_after"].keys() == {"7"}
    save(undone, tmp_path / "it")
    recipe = read_json(tmp_path / "it" / "recipe.json")
    assert [each["name"] for each in recipe["objects"]] == ["7"]


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
    assert anew.metrics["train"] == {"psnr": 30.0}


def test_painting_one_anew_replaces_its_layer_and_keeps_the_others(folder: Path, tmp_path: Path):
    """In its place of the stack, as if it had been painted so from the first."""
    twice = adjust(opened(folder / "twice"), 0.3, objects="7")
    anew = painted(twice, "red", folder / "night.png", quality="normal")
    assert anew.painted_objects == ("red", "7")
    assert anew.layers[1] is twice.layers[1]
    alone = painted(
        opened(folder / "trained"),
        "red",
        folder / "night.png",
        quality="normal",
        measured=False,
    )
    for name in ("sh0", "shN", "opacity_factors", "parents", "canvas_sh0"):
        assert torch.equal(getattr(alone.layers[0], name), getattr(anew.layers[0], name)), name
    others = ~(own_rows(anew, "7") | own_rows(anew, "red"))[: len(SPLATS)]
    first = torch.arange(len(SPLATS))
    assert_same_splats(anew.splats[first][others], twice.splats[first][others])
    save(anew, tmp_path / "it")
    again = read_recipe(tmp_path / "it" / "recipe.json")  # the other is painted on the new one
    made = stylize_unmeasured(opened(folder / "trained"), again, device="cpu").scene
    assert torch.equal(made.layers[0].sh0, anew.layers[0].sh0)
    assert made.painted_objects == anew.painted_objects
    undone = adjust(opened(tmp_path / "it"), undo=True)
    assert_same_splats(undone.splats, opened(folder / "trained").splats)


def test_what_is_painted_anew_does_not_see_the_layers_above(folder: Path):
    night = folder / "night.png"
    twice = opened(folder / "twice")
    seen = painted(twice, "red", night, measured=False).layers[0]
    strange = adjust(twice, 1.5, objects="7")
    assert torch.equal(painted(strange, "red", night, measured=False).layers[0].sh0, seen.sh0)


def test_several_are_painted_anew_the_lowest_first(folder: Path):
    """Whatever the order in which they are named."""
    night = folder / "night.png"
    styles = {"7": Style(night, config=FAST), "red": Style(night, config=FAST)}
    anew = stylize(opened(folder / "twice"), styles, device="cpu")
    assert anew.painted_objects == ("red", "7")
    first = stylize(opened(folder / "trained"), dict(reversed(styles.items())), device="cpu")
    assert_same_splats(anew.splats, first.splats)


def test_a_part_of_what_is_painted_gets_a_layer_above(folder: Path, tmp_path: Path):
    """And what was there comes back when that is removed."""
    both = select(opened(folder / "twice"), "either", plus=("red", "7"))
    over = painted(both, "either", folder / "wave.png", measured=False)
    assert over.painted_objects == ("red", "7", "either")
    rows = torch.arange(len(SPLATS))
    assert not torch.equal(over.splats.sh0[rows], both.splats.sh0[rows])
    assert_same_splats(adjust(over, objects="either", undo=True).splats, both.splats)
    save(over, tmp_path / "over")
    assert_same_splats(adjust(opened(tmp_path / "over"), 0.0, objects="either").splats, both.splats)
    without = adjust(over, objects="red", undo=True)
    assert without.painted_objects == ("7", "either")
    assert_same_splats(adjust(without, undo=True).splats, opened(folder / "trained").splats)


def test_what_has_no_name_any_longer_is_painted_anew_by_its_layer(folder: Path):
    nameless = delete(opened(folder / "once"), "red")
    anew = painted(nameless, "red", folder / "night.png", measured=False)
    assert anew.painted_objects == ("red",) and "red" not in anew.objects
    assert torch.equal(anew.layers[0].rows, nameless.layers[0].rows)


def test_names_are_known_before_anything_is_cleared_or_painted(folder: Path, said: list[str]):
    """Also those of later runs, whose mistakes would else come after minutes."""
    night = folder / "night.png"
    style = Style(night, config=FAST)
    with pytest.raises(StyleSplatError, match="no object 'lid'"):
        stylize(opened(folder / "trained"), {"red": style, "lid": style}, device="cpu")
    assert not said, "not even the first is begun"


@pytest.mark.parametrize("first", ["red", "green"])
def test_one_after_the_other_gives_what_was_before_both(folder: Path, first: str):
    """Without a folder in between, as in a program; each has a canvas."""
    trained = opened(folder / "trained")
    style = Style(folder / "night.png", config=FAST)
    both = stylize_unmeasured(trained, {"red": style, "green": style}, device="cpu").scene
    assert all(len(layer.canvas) for layer in both.layers)
    other = "green" if first == "red" else "red"
    one = adjust(both, objects=first, undo=True)
    assert_same_splats(adjust(one, objects=other, undo=True).splats, trained.splats)
    own = trained.objects[first].picked
    rows = torch.arange(len(SPLATS))[own]
    assert_same_splats(one.splats[rows], trained.splats[rows])

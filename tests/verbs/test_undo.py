"""Paint taken back, adjusted and replaced, object by object, beside others that stay."""

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
)
from balls import contents as all_contents
from stylesplat.errors import StyleSplatError
from stylesplat.io.json_yaml import read_json
from stylesplat.io.scene_folder import save
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")
ROWS = torch.arange(len(SPLATS))


def contents(folder: Path) -> dict[str, bytes]:
    return all_contents(folder, "metrics.json")


def test_undoing_the_first_leaves_the_second_alone(stack: Path, tmp_path: Path):
    twice, trained = opened(stack / "twice"), opened(stack / "trained")
    save(adjust(twice, undo=True, objects=["red"]), tmp_path / "undone")
    undone = opened(tmp_path / "undone")
    others = ~own_rows(undone, "green")
    assert_same_splats(undone.splats[others], trained.splats[others])
    assert_same_splats(undone.splats[~others], twice.splats[own_rows(twice, "green")])
    assert undone.painted_objects == ("green",)
    assert undone.objects.keys() == TRAINED.objects.keys()
    before = (stack / "twice/layers/02-green.safetensors").read_bytes()
    assert (tmp_path / "undone/layers/01-green.safetensors").read_bytes() == before
    loud = adjust(undone, 1.2)
    assert_same_splats(adjust(loud, FAST.intensity).splats, undone.splats)
    assert evaluate(loud, device="cpu")["nnfm_after"].keys() == {"green"}
    recipe = read_json(tmp_path / "undone/recipe.json")
    assert [each["name"] for each in recipe["objects"]] == ["green"]


@pytest.mark.parametrize("order", [("red", "green"), ("green", "red")])
def test_undoing_one_after_the_other_is_undoing_all(
    order: tuple[str, str], stack: Path, tmp_path: Path
):
    scene = opened(stack / "twice")
    for number, name in enumerate(order):
        save(adjust(scene, objects=name, undo=True), tmp_path / str(number))
        scene = opened(tmp_path / str(number))
    assert contents(tmp_path / "1") == contents(stack / "trained")
    both = adjust(opened(stack / "twice"), objects=order, undo=True)
    assert not both.layers and both.splats is both.base and both.metrics == {"psnr": 30.0}
    assert_same_splats(both.splats, opened(stack / "trained").splats)


def test_intensity_0_shows_the_colours_before_and_goes_back(stack: Path, tmp_path: Path):
    once, twice = opened(stack / "once"), opened(stack / "twice")
    none = adjust(once, 0.0)
    assert_same_splats(none.splats, opened(stack / "trained").splats)
    assert_same_splats(adjust(none, FAST.intensity).splats, once.splats)
    assert_same_objects(adjust(none, FAST.intensity), once)
    save(adjust(twice, 0.0, objects="red"), tmp_path / "one")
    scene = opened(tmp_path / "one")
    red = scene.objects["red"].mask
    assert_same_splats(scene.splats[scene.to_splats(red)], scene.base[red])
    others = ~twice.to_splats(red)
    assert torch.equal(scene.splats.sh0[~scene.to_splats(red)], twice.splats.sh0[others])
    assert scene.metrics == {"train": {"psnr": 30.0}}


def test_painting_one_anew_replaces_its_layer_and_keeps_the_others(
    stack: Path, tmp_path: Path, said: list[str]
):
    """From its own colours, in its place of the stack, as if it had been painted so first."""
    twice, night = adjust(opened(stack / "twice"), 0.3, objects="green"), stack / "night.png"
    anew = painted(twice, "red", night, quality="normal")
    assert "Painting red anew, from the colours before." in said
    assert anew.painted_objects == ("red", "green") and anew.layers[1] is twice.layers[1]
    others = ~(own_rows(anew, "green") | own_rows(anew, "red"))[: len(SPLATS)]
    assert_same_splats(anew.splats[ROWS][others], twice.splats[ROWS][others])
    save(anew, tmp_path / "it")
    again = read_recipe(tmp_path / "it" / "recipe.json")  # the other is painted on the new one
    trained = opened(stack / "trained")
    made = stylize(trained, again, device="cpu", measured=False)
    for name in ("sh0", "shN", "opacity_factors", "parents", "surfels_sh0"):
        assert torch.equal(getattr(made.layers[0], name), getattr(anew.layers[0], name)), name
    assert made.painted_objects == anew.painted_objects
    assert_same_splats(adjust(opened(tmp_path / "it"), undo=True).splats, trained.splats)


def test_a_part_of_what_is_painted_gets_a_layer_above(stack: Path, tmp_path: Path):
    """And what was there comes back when that is removed."""
    both = select(opened(stack / "twice"), "either", plus=("red", "green"))
    over = painted(both, "either", stack / "wave.png", measured=False)
    assert over.painted_objects == ("red", "green", "either")
    assert not torch.equal(over.splats.sh0[ROWS], both.splats.sh0[ROWS])
    assert_same_splats(adjust(over, objects="either", undo=True).splats, both.splats)
    save(over, tmp_path / "over")
    assert_same_splats(adjust(opened(tmp_path / "over"), 0.0, objects="either").splats, both.splats)
    without = adjust(over, objects="red", undo=True)
    assert without.painted_objects == ("green", "either")
    assert_same_splats(adjust(without, undo=True).splats, opened(stack / "trained").splats)


def test_names_are_known_before_anything_is_painted(stack: Path, said: list[str]):
    style = Style(stack / "night.png", config=FAST)
    with pytest.raises(StyleSplatError, match="no object 'lid'"):
        stylize(opened(stack / "trained"), {"red": style, "lid": style}, device="cpu")
    assert not said, "not even the first is begun"


def test_nothing_to_undo_or_adjust(stack: Path):
    with pytest.raises(StyleSplatError, match=r"trained is not styled\. Style it first"):
        adjust(opened(stack / "trained"), undo=True)
    with pytest.raises(StyleSplatError, match=r"The scene is not styled"):
        adjust(TRAINED, 0.5)
    once = opened(stack / "once")
    with pytest.raises(StyleSplatError, match="Nothing to adjust"):
        adjust(once)
    for undo in (False, True):
        with pytest.raises(StyleSplatError, match=r"green is not styled in .*once\. Styled objec"):
            adjust(once, 0.5, undo=undo, objects=["red", "green"])
    for intensity, form in ((1.6, None), (None, -1.0)):
        with pytest.raises(StyleSplatError, match=r"use 0 to 1\.5"):
            adjust(once, intensity, form=form)
    with pytest.raises(StyleSplatError, match="--overwrite"):
        save(adjust(once, undo=True), stack / "trained")

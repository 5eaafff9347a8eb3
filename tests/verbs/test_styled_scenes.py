"""Styled scenes: adjusted, styled again, made again from their recipe, and undone."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import (
    GREEN,
    RED,
    SPLATS,
    TRAINED,
    assert_same_objects,
    assert_same_splats,
    contents,
    opened,
    own_rows,
    painted,
    write_painted,
)
from balls import PAINTED_FAST as FAST
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import revise, save
from stylesplat.scene.compose import strengths_of
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, styled once, and once more; and two pictures."""
    folder = tmp_path_factory.mktemp("styled")
    return write_painted(folder, "green", lambda wave, night: (night, wave))


def test_confidence_stays_with_its_gaussians(folder: Path):
    before = opened(folder / "trained").splats
    assert before.confidence is not None and before.identities is not None
    for name, mine in (("once", RED), ("twice", RED | GREEN)):
        after = opened(folder / name).splats
        assert after.confidence is not None
        assert torch.equal(after.confidence[: len(before)], before.confidence)
        new = after.confidence[len(before) :]
        assert len(new) and torch.isin(new, before.confidence[mine]).all()


@pytest.mark.parametrize("styled", ["once", "twice"])
def test_styles_can_be_undone_to_the_bit(styled: str, folder: Path, tmp_path: Path):
    scene = opened(folder / styled)
    assert len(scene.splats) > len(SPLATS) + 20, "it has a canvas"
    save(adjust(scene, 0.3), tmp_path / "adjusted")
    adjusted = opened(tmp_path / "adjusted")
    revise(adjusted, adjust(adjusted, 1.2), tmp_path / "adjusted")
    adjusted = opened(tmp_path / "adjusted")
    save(adjust(adjusted, undo=True), tmp_path / "undone")
    revise(adjusted, adjust(adjusted, undo=True), tmp_path / "adjusted")
    for undone in (tmp_path / "undone", tmp_path / "adjusted"):
        assert contents(undone) == contents(folder / "trained")


def test_picks_and_identities_follow_the_canvas(folder: Path):
    scene = opened(folder / "twice")
    new = torch.arange(len(scene.splats)) >= len(SPLATS)
    red, green, both = (scene.objects[name].picked for name in ("red", "green", "both"))
    assert torch.equal(both, red | green)
    assert torch.equal(both[new], new[new]) and (red & new).any()
    assert scene.splats.identities is not None
    for picked, number in ((red, 1), (green, 2)):
        assert (scene.splats.identities[picked].argmax(dim=1) == number).all()


def test_a_second_style_leaves_the_first_alone(folder: Path):
    once, twice = (opened(folder / name) for name in ("once", "twice"))
    green = once.objects["green"].picked
    rows = torch.arange(len(once.splats))
    assert_same_splats(twice.splats[rows][~green], once.splats[~green])
    assert once.painted_objects == ("red",)
    assert twice.painted_objects == ("red", "green")
    files = [folder / name / "layers/01-red.safetensors" for name in ("once", "twice")]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert twice.metrics["train"] == {"psnr": 30.0}


def test_what_was_measured_is_there_for_every_object(folder: Path):
    wave, night = folder / "wave.png", folder / "night.png"
    styles = {"red": Style(wave, config=FAST), "7": Style(night, config=FAST, steps=2)}
    metrics = stylize(TRAINED, styles, device="cpu").metrics
    assert metrics["steps"] == 5
    assert metrics["nnfm_before"].keys() == metrics["seconds_by_object"].keys() == {"red", "7"}


def test_intensity_0_shows_the_colors_before_and_goes_back(folder: Path):
    styled = opened(folder / "once")
    none = adjust(styled, 0.0)
    assert_same_splats(none.splats, opened(folder / "trained").splats)
    assert_same_splats(adjust(none, FAST.intensity).splats, styled.splats)
    assert_same_objects(adjust(none, FAST.intensity), styled)


def test_objects_that_were_styled_by_id_stay_what_they_were(folder: Path, tmp_path: Path):
    """Among the Gaussians with a canvas, outliers of an id are others than before."""
    styled = painted(opened(folder / "trained"), "3", folder / "wave.png", object_size=48)
    assert len(styled.splats) > len(SPLATS)
    save(styled, tmp_path / "styled")
    none = adjust(opened(tmp_path / "styled"), 0.0)
    assert_same_splats(none.splats, styled.unpainted)
    count = len(SPLATS)
    repainted = (styled.splats.sh0[:count] != styled.unpainted.sh0).flatten(1).any(dim=1)
    assert repainted.any() and not (repainted & ~own_rows(none, "3")).any()
    assert adjust(none, undo=True).objects.keys() == TRAINED.objects.keys()


def test_the_recipe_of_a_styled_scene_makes_it_again(folder: Path, tmp_path: Path):
    styled = folder / "twice"
    recipe = read_recipe(styled / "recipe.json", defaults=StyleConfig(steps=999, seed=9))
    _, green = recipe.objects
    own = replace(FAST, quality="draft")
    assert (green.name, green.style.config, green.features) == ("green", own, "compact")
    assert green.style.pictures == (folder / "night.png", folder / "wave.png")
    save(stylize(opened(folder / "trained"), recipe, device="cpu"), tmp_path / "again")
    again, scene = opened(tmp_path / "again"), opened(styled)
    assert_same_splats(again.splats, scene.splats)
    assert_same_objects(again, scene)
    assert (tmp_path / "again/recipe.json").read_bytes() == (styled / "recipe.json").read_bytes()


def test_every_object_can_be_adjusted_afterwards(folder: Path, tmp_path: Path):
    twice = opened(folder / "twice")
    save(adjust(twice, 0.0, objects="red"), tmp_path / "one")
    scene = opened(tmp_path / "one")
    red, before = scene.objects["red"].picked, scene.unpainted
    assert_same_splats(scene.splats[red], before[scene.objects["red"].picked[: len(SPLATS)]])
    others = ~twice.objects["red"].picked
    assert torch.equal(scene.splats.sh0[~red], twice.splats.sh0[others])
    assert scene.metrics == {"train": {"psnr": 30.0}}


def test_a_recipe_holds_what_each_object_has_of_its_own(folder: Path, tmp_path: Path):
    own = replace(FAST, steps=2, color="keep", intensity=0.9, region=(1, 2, 60, 50))
    red, green = Style(folder / "wave.png", config=FAST), Style(folder / "night.png", config=own)
    styled = stylize(TRAINED, {"red": red, "green": green}, device="cpu")
    adjusted = adjust(styled, 1.1, objects="red")
    assert strengths_of(adjusted) == {"red": 1.1, "green": 0.9}
    save(adjusted, tmp_path / "styled")
    found = read_recipe(tmp_path / "styled" / "recipe.json", defaults=StyleConfig()).objects
    assert [each.style.config for each in found] == [FAST, own]
    assert [each.style.pictures for each in found] == [red.pictures, green.pictures]
    assert [each.intensity for each in found] == [1.1, 0.9]


def test_nothing_to_undo_or_adjust(folder: Path):
    with pytest.raises(StyleSplatError, match=r"trained is not styled\. Style it first"):
        adjust(opened(folder / "trained"), undo=True)
    with pytest.raises(StyleSplatError, match=r"The scene is not styled"):
        adjust(TRAINED, 0.5)
    once = opened(folder / "once")
    with pytest.raises(StyleSplatError, match="Nothing to adjust"):
        adjust(once)
    with pytest.raises(StyleSplatError, match=r"green is not styled in .*once\. Styled objects: r"):
        adjust(once, 0.5, objects=["red", "green"])
    with pytest.raises(StyleSplatError, match=r"use 0 to 1\.5"):
        adjust(once, 1.6)
    with pytest.raises(StyleSplatError, match="--overwrite"):
        save(adjust(once, undo=True), folder / "trained")

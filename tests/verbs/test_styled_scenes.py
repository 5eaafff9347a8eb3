"""Styled scenes on disk: adjusted, styled again, made again from their recipe, and undone."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation import style as report
from stylesplat.io.scene_folder import Scene, read_scene, write_scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.style_config import StyleConfig
from stylesplat.verbs.adjust import adjust_scene, undo_scene
from stylesplat.verbs.recipe import StyledObject, read_recipe
from stylesplat.verbs.stylize import stylize_scene

FAST = StyleConfig(steps=3, layers=(1,), object_size=30, intensity=0.6, max_growth=3.0)
GENERATOR = torch.Generator().manual_seed(0)
ROWS = torch.arange(len(SPLATS))
RED, GREEN = ((ROWS >= start) & (ROWS < start + 80) for start in (200, 280))
TRAINED = Scene(
    splats=replace(
        SPLATS,
        shN=0.1 * torch.randn(len(SPLATS), 15, 3, generator=GENERATOR),
        confidence=ROWS / len(SPLATS),
    ),
    cameras=CAMERAS,
    picks={"red": RED, "green": GREEN, "both": RED | GREEN},
    objects={name: {"ids": []} for name in ("red", "green", "both")},
    info={"test_views": [CAMERAS.names[0]], "settings": {"downscale": 1.0}},
    metrics={"psnr": 30.0},
)


@pytest.fixture(scope="module", autouse=True)
def small_measurements() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "LENGTH", 30.0)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, styled once, and once more; and two pictures."""
    folder = tmp_path_factory.mktemp("styled")
    write_scene(TRAINED, folder / "trained")
    for number, name in enumerate(("wave", "night")):
        pixels = torch.rand(64, 80, 3, generator=GENERATOR) * torch.tensor([1, number, 0.5])
        Image.fromarray((255 * pixels).byte().numpy()).save(folder / f"{name}.png")
    red = StyledObject("red", (folder / "wave.png",), FAST)
    style(folder / "trained", folder / "once", red)
    green = StyledObject("green", (folder / "night.png", folder / "wave.png"), FAST)
    style(folder / "once", folder / "twice", green)
    return folder


def style(path: Path, output: Path, *objects: StyledObject) -> None:
    stylize_scene(path, output, objects, features="compact", device="cpu")


def assert_same(one: Splats, other: Splats) -> None:
    assert one.tensors().keys() == other.tensors().keys()
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name


def test_confidence_stays_with_its_gaussians(folder: Path):
    before = read_scene(folder / "trained").splats
    assert before.confidence is not None and before.identities is not None
    for name, painted in (("once", RED), ("twice", RED | GREEN)):
        after = read_scene(folder / name).splats
        assert after.confidence is not None
        assert torch.equal(after.confidence[: len(before)], before.confidence)
        new = after.confidence[len(before) :]
        assert len(new) and torch.isin(new, before.confidence[painted]).all()


@pytest.mark.parametrize("styled", ["once", "twice"])
def test_styles_can_be_undone_to_the_bit(styled: str, folder: Path, tmp_path: Path):
    scene = read_scene(folder / styled)
    assert len(scene.splats) > len(SPLATS) + 20, "it was split"
    assert scene.unsplit is not None
    adjust_scene(folder / styled, 0.3, output=tmp_path / "adjusted")
    adjust_scene(tmp_path / "adjusted", 1.2)
    undo_scene(tmp_path / "adjusted", tmp_path / "undone")
    undone, before = tmp_path / "undone", folder / "trained"
    assert {path.name for path in undone.iterdir()} == {path.name for path in before.iterdir()}
    for path in before.iterdir():
        if path.suffix != ".json":
            assert (undone / path.name).read_bytes() == path.read_bytes(), path.name
    found, wanted = read_scene(undone), read_scene(before)
    assert_same(found.splats, wanted.splats)
    assert found.splats.classifier is not None and wanted.splats.classifier is not None
    assert found.splats.classifier.ids == wanted.splats.classifier.ids
    assert found.picks.keys() == wanted.picks.keys()
    assert all(torch.equal(found.picks[name], pick) for name, pick in wanted.picks.items())
    assert found.base_colors is found.style_colors is found.unsplit is found.recipe is None
    assert (found.metrics, found.objects, found.info) == (
        *(wanted.metrics, wanted.objects),
        wanted.info,
    )


def test_picks_and_identities_follow_the_split(folder: Path):
    scene = read_scene(folder / "twice")
    new = torch.arange(len(scene.splats)) >= len(SPLATS)
    red, green, both = (scene.picks[name] for name in ("red", "green", "both"))
    assert torch.equal(both, red | green)
    assert torch.equal(both[new], new[new])
    assert (red & new).any() and (green & new).any()
    assert scene.splats.identities is not None
    for picked, number in ((red, 1), (green, 2)):
        assert (scene.splats.identities[picked].argmax(dim=1) == number).all()


def test_a_second_style_leaves_the_first_alone(folder: Path):
    once, twice = (read_scene(folder / name) for name in ("once", "twice"))
    count = len(once.splats)
    green = once.picks["green"]
    rows = torch.arange(count)
    assert_same(twice.splats[rows][~green], once.splats[~green])
    assert once.recipe is not None and twice.recipe is not None
    assert [each["name"] for each in twice.recipe["objects"]] == ["red", "green"]
    assert twice.metrics["train"] == {"psnr": 30.0}


def test_intensity_0_shows_the_colors_before_and_goes_back(folder: Path, tmp_path: Path):
    styled = read_scene(folder / "once")
    adjust_scene(folder / "once", 0.0, output=tmp_path / "none")
    none = read_scene(tmp_path / "none")
    assert styled.base_colors is not None
    for name, colors in styled.base_colors.items():
        assert torch.equal(none.splats.tensors()[name], colors)
    adjust_scene(tmp_path / "none", FAST.intensity)
    back = read_scene(tmp_path / "none").splats
    assert torch.equal(back.sh0, styled.splats.sh0)
    assert torch.equal(back.scales, styled.splats.scales)


def test_objects_that_were_styled_by_id_stay_what_they_were(folder: Path, tmp_path: Path):
    """Among the Gaussians after a split, outliers of an id are others than before."""
    red = StyledObject("3", (folder / "wave.png",), replace(FAST, object_size=48))
    style(folder / "trained", tmp_path / "styled", red)
    styled = read_scene(tmp_path / "styled")
    assert len(styled.splats) > len(SPLATS)
    assert styled.base_colors is not None
    repainted = (styled.splats.sh0 != styled.base_colors["sh0"]).flatten(1).any(dim=1)
    adjust_scene(tmp_path / "styled", 0.0)
    none = read_scene(tmp_path / "styled").splats
    assert torch.equal(none.sh0, styled.base_colors["sh0"])
    assert not (repainted & ~styled.picks["3"]).any()
    undo_scene(tmp_path / "styled", tmp_path / "undone")
    assert read_scene(tmp_path / "undone").picks.keys() == TRAINED.picks.keys()


def test_the_recipe_of_a_styled_scene_makes_it_again(folder: Path, tmp_path: Path):
    styled = folder / "twice"
    recipe = read_recipe(styled / "recipe.json", defaults=StyleConfig(steps=999, seed=9))
    _, green = recipe.objects
    assert (green.name, green.config, recipe.features) == ("green", FAST, "compact")
    assert green.styles == (folder / "night.png", folder / "wave.png")
    source = Path(json.loads((styled / "recipe.json").read_text())["scene"])
    assert source == folder / "trained"
    style(source, tmp_path / "again", *recipe.objects)
    again, scene = read_scene(tmp_path / "again"), read_scene(styled)
    assert torch.equal(again.splats.means, scene.splats.means)
    assert_same(again.splats[again.picks["red"]], scene.splats[scene.picks["red"]])
    assert again.recipe == scene.recipe


def test_an_object_is_styled_once(folder: Path, tmp_path: Path):
    red = StyledObject("red", (folder / "wave.png",), FAST)
    with pytest.raises(StyleSplatError, match=r"red is styled in .*once already.*--undo"):
        style(folder / "once", tmp_path / "again", red)
    assert not (tmp_path / "again").exists()


def test_every_object_can_be_adjusted_afterwards(folder: Path, tmp_path: Path):
    adjust_scene(folder / "twice", 0.0, names=["red"], output=tmp_path / "one")
    scene, twice = read_scene(tmp_path / "one"), read_scene(folder / "twice")
    assert scene.base_colors is not None
    red = scene.picks["red"]
    assert torch.equal(scene.splats.sh0[red], scene.base_colors["sh0"][red])
    assert torch.equal(scene.splats.sh0[~red], twice.splats.sh0[~red])
    assert "nnfm_after" not in scene.metrics


def test_a_recipe_holds_what_each_object_has_of_its_own(folder: Path, tmp_path: Path):
    objects = (
        StyledObject("red", (folder / "wave.png",), FAST),
        StyledObject(
            "green",
            (folder / "night.png",),
            replace(FAST, steps=2, color="keep", intensity=0.9, region=(1, 2, 60, 50)),
        ),
    )
    style(folder / "trained", tmp_path / "styled", *objects)
    adjusted = adjust_scene(tmp_path / "styled", 1.1, names=["red"])
    assert adjusted["intensity"] == {"red": 1.1, "green": 0.9}
    found = read_recipe(tmp_path / "styled" / "recipe.json", defaults=StyleConfig()).objects
    louder = replace(objects[0], config=replace(FAST, intensity=1.1))
    assert found == (louder, objects[1])


def test_nothing_to_undo(folder: Path, tmp_path: Path):
    with pytest.raises(StyleSplatError, match="is not styled: there is nothing to undo"):
        undo_scene(folder / "trained", tmp_path / "undone")
    with pytest.raises(StyleSplatError, match="Pass a folder for the other with -o"):
        undo_scene(folder / "once", None)
    with pytest.raises(StyleSplatError, match="--overwrite"):
        undo_scene(folder / "once", folder / "trained")
    assert not (tmp_path / "undone").exists()

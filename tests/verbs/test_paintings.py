"""What was painted is remembered as it was painted, and can be painted again just so."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest
import torch
from safetensors.torch import load, save

from balls import SPLATS
from painted_balls import (
    FAST,
    RED,
    TRAINED,
    assert_same_objects,
    assert_same_splats,
    paint_of,
    painted,
    write_pictures,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.json_files import read_json
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Recipe, Style, StyledObject
from stylesplat.stylization.style_config import Precision
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")

VGG19 = Path("/work/shared/weights/vgg19_conv1_1-conv3_4.safetensors")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_pictures(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "trained"
    scene_folder.save(TRAINED, folder)
    return folder


@pytest.fixture(scope="module")
def once(trained: Path, pictures: tuple[Path, Path]) -> Scene:
    """The red ball painted; split, too."""
    scene = painted(scene_folder.open(trained), "red", pictures[0])
    assert len(scene.splats) > len(SPLATS)
    return scene


def assert_made_again(styled: Scene, trained: Path, folder: Path) -> None:
    """By the recipe of a styled scene from the scene before: all of it, to the bit."""
    scene_folder.save(styled, folder / "styled")
    recipe = read_recipe(folder / "styled" / "recipe.json")
    again = stylize(scene_folder.open(trained), recipe, device="cpu")
    scene_folder.save(again, folder / "again")
    for path in (folder / "styled").iterdir():
        if path.name != "metrics.json":  # of the last run, and how long it took
            assert (folder / "again" / path.name).read_bytes() == path.read_bytes(), path.name
    one, other = (scene_folder.open(folder / name) for name in ("styled", "again"))
    assert_same_splats(one.splats, other.splats)
    assert_same_objects(one, other)
    for mine, its in zip(paint_of(one).paintings, paint_of(other).paintings, strict=True):
        assert torch.equal(mine.picked, its.picked)
        assert {**vars(mine), "picked": None} == {**vars(its), "picked": None}


def test_a_recipe_makes_again_what_took_several_runs(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    """Neither the order, nor the strengths meanwhile and in the end, are the simple ones."""
    wave, night = pictures
    scene = painted(scene_folder.open(trained), "green", (night, wave), seed=4)
    scene = adjust(scene, 1.3)
    scene = painted(scene, "3", wave, intensity=0.8, steps=2)
    scene = adjust(scene, 0.0, objects="green")
    scene = painted(scene, "blue", night, color="keep", max_growth=1.0)
    scene = adjust(scene, 0.5, objects=("green", "blue"))
    found = paint_of(scene)
    assert found.names == ("green", "3", "blue")
    assert [each.upon for each in found.paintings] == [{}, {"green": 1.3}, {"green": 0, "3": 0.8}]
    assert [each.intensity for each in found.paintings] == [0.5, 0.8, 0.5]
    assert_made_again(scene, trained, tmp_path)


def test_a_recipe_makes_again_paint_of_in_one_run(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    """Each by itself, which differs from one upon the other: they see each other."""
    wave, night = pictures
    styles = {"red": Style(wave, config=FAST), "green": Style(night, config=FAST, intensity=1)}
    alone = stylize(scene_folder.open(trained), styles, device="cpu")
    assert [each.upon for each in paint_of(alone).paintings] == [{}, {}]
    assert_made_again(alone, trained, tmp_path)


@pytest.mark.skipif(not VGG19.is_file(), reason="needs the developers' weights")
def test_a_recipe_makes_again_what_several_networks_painted(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    wave, night = pictures
    vgg19 = {"features": "vgg19", "weights": VGG19}
    scene = painted(scene_folder.open(trained), "red", wave)
    scene = painted(scene, "green", night, network=vgg19)
    scene = adjust(scene, 0.9, objects="green")
    scene = painted(scene, "blue", wave)
    assert_made_again(scene, trained, tmp_path)
    red, green, blue = paint_of(scene).paintings
    assert [each.features for each in (red, green, blue)] == ["compact", "vgg19", "compact"]
    assert red.weights is blue.weights is None
    assert green.weights is not None
    assert green.weights.sha256 == sha256(VGG19.read_bytes()).hexdigest()
    entries = read_json(tmp_path / "styled" / "recipe.json")["objects"]
    assert [each["weights"] for each in entries] == [None, str(VGG19), None]


@pytest.mark.skipif(not VGG19.is_file(), reason="needs the developers' weights")
def test_weights_that_are_others_now_are_refused(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    weights = tmp_path / "vgg19_conv1_1-conv3_4.safetensors"
    weights.write_bytes(VGG19.read_bytes())
    before = scene_folder.open(trained)
    network = {"features": "vgg19", "weights": weights}
    scene_folder.save(painted(before, "red", pictures[0], network=network), tmp_path / "styled")
    tensors = load(weights.read_bytes())
    weights.write_bytes(save({name: tensor / 2 for name, tensor in tensors.items()}))
    recipe = read_recipe(tmp_path / "styled" / "recipe.json")
    with pytest.raises(StyleSplatError, match="holds other weights than those that were used"):
        stylize(before, recipe, device="cpu")
    stylize(before, recipe, features="compact", device="cpu")


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_the_precision_is_recorded_and_replayed_whatever_is_fastest_here(
    precision: Precision, trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    style = Style(pictures[0], config=FAST)
    recipe = Recipe((StyledObject("red", style, precision=precision),))
    scene = stylize(scene_folder.open(trained), recipe, device="cpu")
    assert scene.metrics["precision"] == precision
    assert_made_again(scene, trained, tmp_path)
    (entry,) = json.loads((tmp_path / "again" / "recipe.json").read_text())["objects"]
    assert entry["precision"] == precision
    other = stylize(scene_folder.open(trained), {"red": style}, device="cpu")
    fastest = paint_of(other).paintings[0].precision
    assert fastest == other.metrics["precision"]
    same = torch.equal(other.splats.sh0, scene.splats.sh0)
    assert same == (fastest == precision), "the two differ"


def test_older_recipes_say_no_precision(once: Scene, trained: Path, tmp_path: Path):
    scene_folder.save(once, tmp_path / "styled")
    file = tmp_path / "styled" / "recipe.json"
    content = json.loads(file.read_text())
    del content["objects"][0]["precision"]
    file.write_text(json.dumps(content))
    assert paint_of(scene_folder.open(tmp_path / "styled")).paintings[0].precision is None
    again = stylize(scene_folder.open(trained), read_recipe(file), device="cpu")
    assert_same_splats(again.splats, once.splats)


def test_a_recipe_may_say_what_an_object_is_painted_upon(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    """Also an object of the same recipe, at a strength that it does not keep."""
    style = Style(pictures[0], config=FAST)
    objects = (StyledObject("red", style), StyledObject("green", style, upon={"red": 0.2}))
    scene = stylize(scene_folder.open(trained), Recipe(objects), device="cpu")
    assert paint_of(scene).paintings[1].upon == {"red": 0.2}
    assert [each.intensity for each in paint_of(scene).paintings] == [0.6, 0.6]
    assert_made_again(scene, trained, tmp_path)


def test_what_an_object_was_painted_upon_may_be_gone(
    trained: Path, pictures: tuple[Path, Path], said: list[str]
):
    style = Style(pictures[0], config=FAST)
    recipe = Recipe((StyledObject("green", style, upon={"red": 0.2}),))
    scene = stylize(scene_folder.open(trained), recipe, device="cpu")
    assert "green was painted upon red, which is not there now." in said
    assert paint_of(scene).paintings[0].upon == {}


def test_colours_that_were_never_a_file(trained: Path, tmp_path: Path, said: list[str]):
    """They can be adjusted, undone and painted beside, but not painted again."""
    colors = torch.rand(64, 80, 3, generator=torch.Generator().manual_seed(2))
    style = Style(colors, config=FAST)
    styled = stylize(scene_folder.open(trained), {"red": style}, device="cpu")
    scene_folder.save(styled, tmp_path / "styled")
    found = scene_folder.open(tmp_path / "styled")
    assert paint_of(found).paintings[0].styles == style.sources()
    assert style.sources()[0].path is None
    assert_same_splats(adjust(found, undo=True).splats, scene_folder.open(trained).splats)
    with pytest.raises(StyleSplatError, match=r"red: it was painted with colours that were never"):
        read_recipe(tmp_path / "styled" / "recipe.json")
    assert "nnfm_after" not in evaluate(found, device="cpu")
    assert "red is not compared with its style: its style was never a file." in said


# A name that means something else now: other Gaussians, fewer, more
ANEW = {
    "other": {"id": 300},
    "shrunk": {"plus": "red", "box3d": (), "minus": "part"},
    "grown": {"plus": ("red", "green")},
}


@pytest.fixture(params=ANEW)
def anew(request: pytest.FixtureRequest, once: Scene, tmp_path: Path) -> Scene:
    """What `once` holds, from disk, after `red` was selected anew."""
    x, y, z = TRAINED.splats.means[RED].mean(dim=0).tolist()
    scene = select(once, "part", box3d=(x, y - 9, z - 9, x + 9, y + 9, z + 9))
    scene = select(scene, "red", **ANEW[request.param])
    scene_folder.save(scene, tmp_path / "anew")
    scene = scene_folder.open(tmp_path / "anew")
    assert not torch.equal(scene.objects["red"].picked, once.objects["red"].picked)
    return scene


def test_a_name_that_was_selected_anew_changes_nothing_that_was_painted(
    anew: Scene, once: Scene, tmp_path: Path
):
    assert torch.equal(paint_of(anew).paintings[0].picked, paint_of(once).paintings[0].picked)
    for intensity in (0.0, 1.2):
        assert_same_splats(adjust(anew, intensity).splats, adjust(once, intensity).splats)
    undone = adjust(anew, undo=True)
    assert_same_splats(undone.splats, scene_folder.open(_origin(once)).splats)
    count = len(undone.splats)
    assert torch.equal(undone.objects["red"].picked, anew.objects["red"].picked[:count])
    numbers, wanted = (evaluate(scene, device="cpu") for scene in (anew, once))
    assert numbers == wanted and wanted["nnfm_after"].keys() == {"red"}


def _origin(scene: Scene) -> Path:
    origin = paint_of(scene).origin
    assert origin is not None
    return origin


def test_paint_of_is_not_painted_again_by_another_name(anew: Scene, pictures: tuple[Path, Path]):
    again = select(anew, "vase", id=3)
    with pytest.raises(StyleSplatError, match=r"vase is styled in .* already, as a part of red"):
        painted(again, "vase", pictures[1])
    with pytest.raises(StyleSplatError, match=r"3 is styled in .* already, as a part of red"):
        painted(again, "3", pictures[1])
    both = painted(again, "green", pictures[1])
    assert paint_of(both).names == ("red", "green")


def test_a_label_id_that_was_painted_is_not_painted_by_its_name(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    """Whatever the id means among the Gaussians after the split."""
    scene_folder.save(painted(scene_folder.open(trained), "3", pictures[0]), tmp_path / "styled")
    styled = scene_folder.open(tmp_path / "styled")
    with pytest.raises(StyleSplatError, match=r"red is styled in .* already, as a part of 3\."):
        painted(styled, "red", pictures[1])


def test_undoing_keeps_what_was_named_since(once: Scene):
    scene = select(once, "new", id=7)
    new = torch.arange(len(scene.splats)) >= len(SPLATS)
    objects = {
        **scene.objects,
        "split": SceneObject(new),
        "nothing": SceneObject(torch.zeros_like(new)),
    }
    undone = adjust(replace(scene, objects=objects), undo=True)
    assert undone.objects.keys() == {*TRAINED.objects, "new", "nothing"}, (
        "what the split made is gone"
    )
    assert torch.equal(undone.objects["red"].picked, RED)

"""What was painted is remembered as it was painted, and can be painted again just so."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest
import torch
from PIL import Image
from safetensors.torch import load, save

from balls import (
    BALLS,
    CAMERAS,
    RED,
    SPLATS,
    TRAINED,
    assert_same_layers,
    assert_same_objects,
    assert_same_splats,
    contents,
    painted,
)
from balls import PAINTED_FAST as FAST
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.json_yaml import read_json
from stylesplat.rendering.weights import coverage
from stylesplat.scene.scene import Scene
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Recipe, Style, StyledObject
from stylesplat.verbs.adjust import adjust, recolor
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.objects import objects, rename
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")

SHARED = Path(__file__).parents[3] / "shared"  # beside the checkout, where there is one
VGG19 = SHARED / "weights" / "vgg19_conv1_1-conv3_4.safetensors"


@pytest.fixture
def pictures(stack: Path) -> tuple[Path, Path]:
    return stack / "wave.png", stack / "night.png"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The balls from fewer views, so that they are painted sooner."""
    path = tmp_path_factory.mktemp("paintings") / "trained"
    scene_folder.save(replace(TRAINED, cameras=CAMERAS[::2]), path)
    return path


@pytest.fixture
def once(stack: Path) -> Scene:
    scene = scene_folder.open(stack / "once")
    assert len(scene.splats) > len(SPLATS), "it has a canvas"
    return scene


def assert_made_again(styled: Scene, trained: Path, folder: Path) -> None:
    """By the recipe of a styled scene from the scene before: all of it, to the bit."""
    scene_folder.save(styled, folder / "styled")
    recipe = read_recipe(folder / "styled" / "recipe.json")
    again = stylize(scene_folder.open(trained), recipe, device="cpu", measured=False)
    scene_folder.save(again, folder / "again")
    found, wanted = (contents(folder / name, "metrics.json") for name in ("again", "styled"))
    assert found == wanted
    one, other = (scene_folder.open(folder / name) for name in ("styled", "again"))
    assert_same_objects(one, other)
    assert_same_layers(one, other)


def test_what_objects_counts_as_its_own_is_painted(tmp_path: Path):
    path = tmp_path / "style.png"
    Image.effect_noise((64, 48), 60).convert("RGB").save(path)
    scene = painted(TRAINED, "red", path, quality="draft")  # no canvas: Gaussians change colour
    changed = (scene.splats.sh0 != TRAINED.splats.sh0).flatten(1).any(dim=1)
    (red,) = (each for each in objects(TRAINED) if each["id"] == 3)
    assert changed.sum() <= red["own"] <= changed.sum() + 2, "but for hidden ones"


def test_a_recipe_makes_again_what_took_several_runs(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    """What the strengths were meanwhile is that of the settings, in the end they are others."""
    wave, night = pictures
    draft = {"quality": "draft", "measured": False}
    scene = painted(scene_folder.open(trained), "green", (night, wave), seed=4, **draft)
    mask = torch.linspace(0, 1, len(scene.layers[0].rows))
    scene = scene.with_layer(replace(scene.layers[0], mask=mask))
    scene = painted(scene, "3", Path("material:jade"), intensity=0.8, steps=2, **draft)
    scene = recolor(scene, "3", hue=40.0)
    recoloring = scene.layers[-1]
    scene = scene.with_layer(replace(recoloring, mask=torch.full(recoloring.rows.shape, 0.5)))
    scene = painted(scene, "green/2", night, **draft)
    scene = scene.with_layer(replace(scene.layers[-1], blend="luminosity"))
    scene = adjust(scene, 0.5, objects="green")
    assert scene.painted_objects == ("green", "3")
    assert [each.name for each in scene.layers] == ["green", "3", "3/recolor", "green/2"]
    assert [each.strength for each in scene.layers] == [0.5, 0.8, 1.0, 0.6]
    assert_made_again(scene, trained, tmp_path)
    assert [each.blend for each in scene_folder.open(tmp_path / "again").layers][-1] == "luminosity"
    restyled = painted(scene, "green", night, **draft).layers[0].mask
    assert restyled is not None and torch.equal(restyled, mask), "it outlives other paint"
    with pytest.raises(StyleSplatError, match="No layer can be called 'green/recolor'"):
        stylize(scene, {"green/recolor": wave})


@pytest.mark.skipif(not VGG19.is_file(), reason="needs the developers' weights")
def test_a_recipe_makes_again_what_several_networks_painted(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    wave, night = pictures
    weights = tmp_path / "vgg19_conv1_1-conv3_4.safetensors"
    weights.write_bytes(VGG19.read_bytes())
    vgg19 = {"features": "vgg19", "weights": weights}
    draft = {"quality": "draft", "measured": False}
    scene = painted(scene_folder.open(trained), "red", wave, **draft)
    scene = painted(scene, "green", night, network=vgg19, **draft)
    scene = adjust(scene, 0.9, objects="green")
    assert_made_again(scene, trained, tmp_path)
    red, green = scene.layers
    assert (red.features, green.features) == ("compact", "vgg19")
    assert red.weights is None and green.weights is not None
    assert green.weights.sha256 == sha256(VGG19.read_bytes()).hexdigest()
    entries = read_json(tmp_path / "styled" / "recipe.json")["objects"]
    assert [each["weights"] for each in entries] == [None, str(weights)]
    tensors = load(weights.read_bytes())
    weights.write_bytes(save({name: tensor / 2 for name, tensor in tensors.items()}))
    recipe = read_recipe(tmp_path / "styled" / "recipe.json")
    with pytest.raises(StyleSplatError, match="holds other weights than those that were used"):
        stylize(scene_folder.open(trained), recipe, device="cpu")


def test_the_precision_is_recorded_and_replayed_whatever_is_fastest_here(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    style, precision = Style(pictures[0], config=FAST), "bfloat16"
    recipe = Recipe((StyledObject("red", style, precision=precision),))
    scene = stylize(scene_folder.open(trained), recipe, device="cpu")
    assert scene.metrics["precision"] == precision
    assert_made_again(scene, trained, tmp_path)
    (entry,) = json.loads((tmp_path / "again" / "recipe.json").read_text())["objects"]
    assert entry["precision"] == precision


def test_colours_that_were_never_a_file(trained: Path, tmp_path: Path, said: list[str]):
    """They can be adjusted, undone and painted beside, but not painted again."""
    colors = torch.rand(64, 80, 3, generator=torch.Generator().manual_seed(2))
    style = Style(colors, config=FAST)
    styles = {"red": style}
    styled = stylize(scene_folder.open(trained), styles, device="cpu", measured=False)
    scene_folder.save(styled, tmp_path / "styled")
    found = scene_folder.open(tmp_path / "styled")
    assert found.layers[0].styles == style.sources()
    assert style.sources()[0].path is None
    assert_same_splats(adjust(found, undo=True).splats, scene_folder.open(trained).splats)
    with pytest.raises(StyleSplatError, match=r"red: it was painted with colours that were never"):
        read_recipe(tmp_path / "styled" / "recipe.json")
    assert "nnfm_after" not in evaluate(found, device="cpu")
    assert "red is not compared with its style: its style was never a file." in said


# A name that means something else now: fewer Gaussians, more
ANEW = {
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
    assert not torch.equal(scene.objects["red"].mask, once.objects["red"].mask)
    return scene


def test_a_name_that_was_selected_anew_changes_nothing_that_was_painted(
    anew: Scene, once: Scene, trained: Path
):
    assert torch.equal(anew.layers[0].rows, once.layers[0].rows)
    for intensity in (0.0, 1.2):
        assert_same_splats(adjust(anew, intensity).splats, adjust(once, intensity).splats)
    undone = adjust(anew, undo=True)
    assert_same_splats(undone.splats, scene_folder.open(trained).splats)
    assert torch.equal(undone.objects["red"].mask, anew.objects["red"].mask)
    numbers, wanted = (evaluate(scene, device="cpu") for scene in (anew, once))
    assert numbers == wanted and wanted["nnfm_after"].keys() == {"red"}


def test_what_is_protected_gets_no_paint(
    trained: Path, pictures: tuple[Path, Path], tmp_path: Path
):
    x, y, z = BALLS[3][0]
    whole = scene_folder.open(trained)
    scene = select(whole, "cap", of="red", box3d=(x - 1, y - 1, z + 0.12, x + 1, y + 1, z + 1))
    cap = scene.objects["cap"].mask
    scene_folder.save(scene, tmp_path / "trained")
    style = {"red": Style(pictures[0], config=FAST)}
    free = stylize(whole, style, device="cpu", measured=False)
    styled = stylize(scene, style, protect="cap", device="cpu", measured=False)
    for name, tensor in scene.splats.tensors().items():
        assert torch.equal(styled.splats.tensors()[name][: len(cap)][cap], tensor[cap]), name
    shown = []
    for painted_scene in (free, styled):
        discs = torch.arange(len(painted_scene.splats)) >= len(cap)
        own = torch.zeros_like(discs).index_fill(0, cap.nonzero()[:, 0], True)
        views = [camera.downscale(0.25) for camera in CAMERAS]
        over = [coverage(painted_scene.splats, each, discs) for each in views]
        there = [coverage(scene.splats, each, own[: len(cap)]) > 0.5 for each in views]
        shown.append(sum(float(a[b].sum()) for a, b in zip(over, there, strict=True)))
    assert shown[1] < 0.2 * shown[0], shown
    assert_made_again(styled, tmp_path / "trained", tmp_path)
    with pytest.raises(StyleSplatError, match=r"all of it is protected \(both\)"):
        stylize(scene, style, protect=["both"], device="cpu")
    renamed = rename(styled, "cap", "lid")
    scene_folder.save(renamed, tmp_path / "renamed")
    (entry,) = read_recipe(tmp_path / "renamed" / "recipe.json").objects
    assert entry.style.config.protect == ("lid",)

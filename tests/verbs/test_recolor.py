"""Objects recoloured in closed form: the maps of colours, the layers, and the command."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from balls import CAMERAS, GREEN, RED, SPLATS, TRAINED, assert_same_splats
from processes import run
from scenes import plain_layer
from stylesplat.errors import StyleSplatError
from stylesplat.io.json_yaml import read_json
from stylesplat.io.scene_folder import open as open_scene
from stylesplat.io.scene_folder import save
from stylesplat.io.style_pictures import MATERIALS
from stylesplat.rendering.render import render
from stylesplat.scene.palette import map_palette
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import map_bands, rgb_from_sh0, sh0_from_rgb, sh_basis
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust, palette, recolor
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.stylize import stylize

ROWS = torch.arange(len(SPLATS))


def colors(scene: Scene, picked: torch.Tensor) -> torch.Tensor:
    return rgb_from_sh0(scene.splats.sh0[picked, 0])


def one_of(color: tuple[float, float, float], **settings: Any) -> torch.Tensor:
    """What becomes of a ball of one colour."""
    red = sh0_from_rgb(torch.tensor(color)).expand(80, 1, 3)
    flat = TRAINED.splats.sh0.index_copy(0, RED.nonzero()[:, 0], red)
    scene = replace(TRAINED, base=replace(TRAINED.splats, sh0=flat))
    return colors(recolor(scene, "red", **settings), RED)[0]


@pytest.mark.parametrize(
    ("settings", "color"),
    [
        ({"hue": 120}, (-0.155, 0.410, -0.153)),  # as a browser draws `filter: hue-rotate(120deg)`
        ({"saturation": 0}, (0.27, 0.27, 0.27)),
        ({"brightness": 1.5}, (1.2, 0.15, 0.15)),
        ({"contrast": 0.5}, (0.65, 0.3, 0.3)),
        ({"brightness": 0.5, "contrast": 2}, (0.3, -0.4, -0.4)),
        ({"tint": "#336699"}, (0.2, 0.4, 0.6)),
        ({"tint": "teal"}, (0.0, 0.502, 0.502)),
    ],
    ids=str,
)
def test_settings_do_what_filters_of_pictures_do(settings: dict, color: tuple[float, ...]):
    found = one_of((0.8, 0.1, 0.1), **settings)
    torch.testing.assert_close(found, torch.tensor(color), atol=0.04, rtol=0)


def test_hues_keep_luma_and_temperature_that_of_grey():
    luma = torch.tensor([0.2126, 0.7152, 0.0722])
    before = torch.tensor([0.5, 0.2, 0.7])
    after = one_of((0.5, 0.2, 0.7), hue=-77)
    assert abs(float((after - before) @ luma)) < 2e-3
    warm = one_of((0.5, 0.5, 0.5), temperature=1)
    assert warm[0] > 0.55 and warm[2] < 0.45 and abs(float(warm @ luma) - 0.5) < 1e-5


def test_bands_of_all_degrees_are_mapped_exactly():
    generator = torch.Generator().manual_seed(0)
    sh0, shN = (torch.randn(9, n, 3, generator=generator) for n in (1, 15))
    color_map = torch.randn(3, 4, generator=generator)
    dirs = torch.nn.functional.normalize(torch.randn(9, 3, generator=generator), dim=1)
    basis = sh_basis(3, dirs)[:, None]

    def shown(*bands: torch.Tensor) -> torch.Tensor:
        return 0.5 + (basis @ torch.cat(bands, dim=1))[:, 0]

    wanted = shown(sh0, shN) @ color_map[:, :3].T + color_map[:, 3]
    torch.testing.assert_close(shown(*map_bands(sh0, shN, color_map)), wanted)


def test_matching_gives_the_mean_and_the_covariance_of_a_picture(tmp_path: Path):
    picture = torch.rand(40, 50, 3, generator=torch.Generator().manual_seed(1))
    picture = (0.2 + picture * torch.tensor([0.1, 0.4, 0.2])).mul(255).round().byte()
    Image.fromarray(picture.numpy()).save(tmp_path / "a.png")
    after = recolor(TRAINED, ["red", "green"], match=tmp_path / "a.png")
    wanted = picture.float().view(-1, 3).mean(dim=0) / 255
    for layer, mask in zip(after.layers, (RED, GREEN), strict=True):
        views = (render(after.splats[mask], CAMERAS[row]) for row in range(len(CAMERAS)))
        shown = torch.cat([(image / alphas)[alphas[..., 0] > 0.5] for image, alphas in views])
        torch.testing.assert_close(shown.mean(dim=0), wanted, atol=0.03, rtol=0)
        assert layer.styles[0].path == tmp_path / "a.png" and layer.styles[0].sha256


def test_only_the_object_changes_and_undoing_is_exact():
    after = recolor(TRAINED, "red", hue=90, strength=0.5)
    assert_same_splats(after.splats[~RED], TRAINED.splats[~RED])
    full = recolor(after, "red", hue=90)
    assert len(full.layers) == 1, "the recolouring that was there is replaced"
    middle = (TRAINED.splats.sh0 + full.splats.sh0) / 2
    torch.testing.assert_close(after.splats.sh0, middle)
    for same in (
        adjust(after, 0.0),
        adjust(after, undo=True),
        adjust(full, objects="red", undo=True),
    ):
        assert_same_splats(same.splats, TRAINED.splats)
    assert after.metrics == {"train": TRAINED.metrics}


def test_the_background_is_what_belongs_to_no_object():
    after = recolor(TRAINED, "background", saturation=0)
    assert torch.equal(after.layers[0].rows, ROWS[:200])
    assert recolor(after, "background", hue=1).layers[0].name == "background/recolor"


def test_paint_above_and_below():
    """A recolouring maps the paint beneath, canvas included; paint above covers it."""
    under = TRAINED.with_layers([plain_layer(TRAINED.splats, ROWS[RED], "red", surfels=30)])
    above = recolor(under, "red", hue=120)
    assert [each.name for each in above.layers] == ["red", "red/recolor"]
    own = torch.cat([RED, torch.ones(30, dtype=torch.bool)])
    assert above.layers[1].color_map is not None
    wanted, _ = map_bands(under.splats.sh0, under.splats.shN, above.layers[1].color_map)
    assert torch.equal(above.splats.sh0[own], wanted[own])
    assert_same_splats(adjust(above, objects="red/recolor", undo=True).splats, under.splats)
    assert [e.name for e in adjust(above, objects="red", undo=True).layers] == ["red/recolor"]
    first = recolor(TRAINED, "red", hue=120)
    painted = first.with_layers([*first.layers, *under.layers])
    assert torch.equal(painted.splats.sh0[len(SPLATS) :], under.splats.sh0[len(SPLATS) :])
    again = recolor(painted, "red", hue=60)
    assert [each.name for each in again.layers] == ["red", "red/recolor"], "on top of the paint"
    half = replace(first.layers[0], mask=torch.full((80,), 0.5), blend="colour", visible=False)
    shown = recolor(first.with_layers([half, *under.layers]), "red", hue=60).layers[1]
    assert shown.blend == "colour" and not shown.visible and shown.mask is not None


def test_scenes_keep_recolourings_and_recipes_replay_them(tmp_path: Path, quick_painting: None):
    Image.effect_mandelbrot((64, 64), (-2, -1, 1, 1), 50).convert("RGB").save(tmp_path / "a.png")
    warm = recolor(TRAINED, "background", temperature=0.5, strength=0.7)
    styles = {"red": quick(tmp_path / "a.png")}
    painted = stylize(warm, styles, device="cpu")
    scene = adjust(
        recolor(painted, "red", tint="teal", match=tmp_path / "a.png"), 0.6, objects="red/recolor"
    )
    save(scene, tmp_path / "scene")
    read = open_scene(tmp_path / "scene")
    assert [(e.name, e.kind) for e in read.layers] == [
        ("background/recolor", "recolour"),
        ("red", "paint"),
        ("red/recolor", "recolour"),
    ]
    torch.testing.assert_close(read.splats.sh0, scene.splats.sh0)
    assert read.layers[2].settings == {"tint": "teal"} and read.layers[2].strength == 0.6
    again = stylize(TRAINED, read_recipe(tmp_path / "scene/recipe.json"), device="cpu")
    torch.testing.assert_close(again.splats.sh0, scene.splats.sh0, atol=2e-4, rtol=1e-4)
    assert evaluate(scene, device="cpu")["nnfm_after"].keys() == {"red"}
    save(adjust(scene, undo=True, objects="red"), tmp_path / "two")
    alone = stylize(TRAINED, read_recipe(tmp_path / "two/recipe.json"), device="cpu")
    assert [each.name for each in alone.layers] == ["background/recolor", "red/recolor"]


PALETTE = torch.tensor([[0.7, 0.1, 0.1], [0.8, 0.8, 0.8], [0.1, 0.3, 0.1]])
BLUE = (0.1, 0.2, 0.7)
SWAPPED = torch.cat([PALETTE, torch.cat([torch.tensor([BLUE]), PALETTE[1:]])], dim=1)


def swapped(*colors: tuple[float, ...]) -> torch.Tensor:
    """Colours after the first entry of `PALETTE` became blue."""
    sh0 = sh0_from_rgb(torch.tensor(colors))[:, None]
    return rgb_from_sh0(map_palette(sh0, torch.zeros(len(sh0), 0, 3), SWAPPED)[0][:, 0])


def test_a_colour_is_exchanged_with_its_shades_and_highlights_stay():
    red, shade, light = swapped((0.7, 0.1, 0.1), (0.35, 0.05, 0.05), (0.85, 0.55, 0.55))
    torch.testing.assert_close(red, torch.tensor(BLUE), atol=0.01, rtol=0)
    torch.testing.assert_close(shade, torch.tensor(BLUE) / 2, atol=0.01, rtol=0)
    assert light[2] > 0.8 and light[0] > 0.4  # half-way to white, as it was
    others = (1.0, 1.0, 1.0), (0.95, 0.9, 0.9), (0.8, 0.8, 0.8), (0.1, 0.3, 0.1), (0.05, 0.05, 0.05)
    torch.testing.assert_close(swapped(*others), torch.tensor(others), atol=0.01, rtol=0)
    grey = torch.linspace(0.01, 0.99, 50)[:, None].expand(50, 3)
    lumas = swapped(*[tuple(row) for row in grey.tolist()]) @ torch.tensor([0.2126, 0.7152, 0.0722])
    assert (lumas.diff() > 0).all()  # a tone curve keeps the order


def test_what_changes_with_the_view_changes_by_the_slope():
    sh0 = sh0_from_rgb(torch.tensor([[0.6, 0.1, 0.1]]))[:, None]
    step = 0.01 * torch.tensor([[[0.5, -0.2, 0.3]]])
    there, bands = map_palette(sh0, step, SWAPPED)
    beside, _ = map_palette(sh0 + step, step, SWAPPED)
    torch.testing.assert_close(bands, beside - there, atol=2e-4, rtol=0.05)


def test_a_swap_is_kept_in_files_replayed_and_undone(tmp_path: Path):
    (first, *_) = palette(TRAINED, "red")
    found = recolor(TRAINED, "red", swap=(f"{first}=#1030c0",), saturation=0.9)
    assert (
        colors(found, RED).mean(dim=0).argmax() == 2 and colors(TRAINED, RED).mean(dim=0)[0] > 0.5
    )
    others = ~RED
    assert torch.equal(found.splats.sh0[others], TRAINED.splats.sh0[others])
    save(found, tmp_path / "scene")
    again = open_scene(tmp_path / "scene")
    assert_same_splats(again.splats, found.splats)
    replayed = stylize(TRAINED, read_recipe(tmp_path / "scene/recipe.json"), device="cpu")
    assert_same_splats(replayed.splats, found.splats)
    assert_same_splats(adjust(again, undo=True, objects="red").splats, TRAINED.splats)


@pytest.mark.parametrize("name", MATERIALS)
def test_the_colours_of_a_material_can_be_matched(name: str):
    material = f"material:{name}"
    found = colors(recolor(TRAINED, "red", match=material), RED).mean(dim=0)
    expected = Style(material).read()[0].reshape(-1, 3).mean(dim=0)
    assert (found - expected).abs().max() < 0.1


def quick(picture: Path) -> Style:
    return Style(picture, steps=2, block=1, object_size=30, quality="draft")


@pytest.mark.parametrize(
    ("settings", "fact"),
    [
        ({}, "Nothing to recolor. Pass a --hue"),
        ({"hue": 0}, "Nothing to recolor"),
        ({"hue": 400}, "with hue 400: use -360 to 360"),
        ({"saturation": -1}, "with saturation -1"),
        ({"hue": float("nan")}, "hue nan"),
        ({"tint": "blurple"}, "no color 'blurple'"),
        ({"swap": ("red",)}, "FROM=TO"),
        ({"swap": ("red=blurple",)}, "no color 'blurple'"),
        ({"swap": ("red=teal", "#f00=gold")}, "same color"),
        ({"match": "lost.jpg"}, "lost.jpg"),
        ({"match": "material:tin"}, r"no material 'tin'.+material:bronze"),
        ({"shade": 2}, "there is no key 'shade'"),
        ({"hue": 3, "strength": 2.0}, "the intensity 2.0"),
    ],
    ids=str,
)
def test_wrong_settings_are_named(settings: dict, fact: str):
    with pytest.raises(StyleSplatError, match=fact):
        recolor(TRAINED, "red", **settings)


def test_objects_that_are_not_there_or_empty():
    with pytest.raises(StyleSplatError, match="no object 'lid'"):
        recolor(TRAINED, "lid", hue=3)
    empty = replace(TRAINED.objects["red"], mask=RED & ~RED)
    scene = replace(TRAINED, objects={**TRAINED.objects, "red": empty})
    with pytest.raises(StyleSplatError, match="red: it has no Gaussians"):
        recolor(scene, "red", hue=3)
    with pytest.raises(StyleSplatError, match="form shows in paint only"):
        adjust(recolor(TRAINED, "red", hue=3), form=0.5, objects="red")


def test_the_command_changes_a_scene_or_makes_another(tmp_path: Path, capsys):
    save(TRAINED, tmp_path / "scene")
    assert run("recolor", tmp_path / "scene", "--object", "red", "--hue", 90, "--json") == 0
    assert open_scene(tmp_path / "scene").layers[0].settings == {"hue": 90.0}
    assert read_json(tmp_path / "scene/layers.json")["layers"][0]["kind"] == "recolour"
    assert (tmp_path / "scene/before_after.png").is_file()
    swaps = ("--swap", "red=teal", "--swap", "red=teal")
    assert run("recolor", tmp_path / "scene", "--object", "red", *swaps) == 0
    assert open_scene(tmp_path / "scene").layers[0].settings == {"swap": ["red=teal", "red=teal"]}
    other = tmp_path / "other"
    assert run("adjust", tmp_path / "scene", "--object", "red/recolor", "--undo", "-o", other) == 0
    assert_same_splats(open_scene(other).splats, open_scene(tmp_path / "scene").base)
    assert run("recolor", other, "--object", "red", "--strength", 0.5) == 1
    assert "Nothing to recolor" in capsys.readouterr().err

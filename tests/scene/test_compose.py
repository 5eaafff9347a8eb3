"""Laws of a base and its stack of layers."""

from dataclasses import replace

import pytest
import torch

from scenes import SETTINGS, plain_layer, random_splats, two_cameras
from stylesplat.rendering.render import rasterize
from stylesplat.scene.compose import (
    beneath,
    compose,
    family,
    splats_without_paint,
    with_layers,
    with_strengths,
    without_layers,
)
from stylesplat.scene.layer import Layer
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import SH_C0, Classifier, Splats

COUNT = 60
ROWS = torch.arange(COUNT)
CLASSIFIER = Classifier(torch.zeros(2, 16), torch.zeros(2), (0, 3))
BASE = replace(random_splats(COUNT), classifier=CLASSIFIER, confidence=ROWS / COUNT)
FOX = plain_layer(BASE, ROWS[:20], "fox", canvas=30, seed=1)
POT = plain_layer(BASE, ROWS[40:], "pot", canvas=10, seed=2)
BOTH = plain_layer(BASE, ROWS[10:50], "both", canvas=5, seed=3)  # above the two
STACK = (FOX, POT, BOTH)
SCENE = Scene(
    BASE,
    two_cameras(),
    objects={
        "fox": SceneObject(ROWS < 20, {"gaussians": 20}),
        "nothing": SceneObject(ROWS < 0),
    },
    metrics={"psnr": 30.0},
)
PAINTED = replace(with_layers(SCENE, STACK), metrics={"train": SCENE.metrics})


def assert_equal(one: Splats, other: Splats) -> None:
    assert one.tensors().keys() == other.tensors().keys()
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name


@pytest.mark.parametrize("gone", STACK, ids=lambda layer: layer.object)
@pytest.mark.parametrize("way", ["strength 0", "hidden"])
def test_what_does_not_show_is_as_if_it_was_removed(gone: Layer, way: str):
    """To the bit, in whatever place of the stack."""
    hidden = replace(gone, strength=0.0) if way == "strength 0" else replace(gone, visible=False)
    left = [each for each in STACK if each is not gone]
    found = compose(BASE, [hidden if each is gone else each for each in STACK])
    assert_equal(found, compose(BASE, left))
    assert_equal(without_layers(PAINTED, [gone.object]).splats, found)


def test_the_base_comes_first_and_canvases_in_the_order_of_the_stack():
    splats = PAINTED.splats
    assert len(splats) == COUNT + 45
    assert torch.equal(splats.means, torch.cat([BASE.means, *(e.canvas.means for e in STACK)]))
    for name in ("means", "quats", "scales"):
        assert torch.equal(getattr(splats, name)[:COUNT], getattr(BASE, name))
    rows = torch.cat([ROWS, *(each.parents for each in STACK)])
    assert torch.equal(family(PAINTED), rows)
    for name in ("identities", "confidence"):
        assert torch.equal(getattr(splats, name), getattr(BASE, name)[rows])
    untouched = compose(BASE, [FOX])
    assert_equal(untouched[ROWS[20:]], BASE[ROWS[20:]])


def test_colours_go_as_far_as_strength_and_share_say():
    for strength in (0.3, 1.0, 1.4):
        found = compose(BASE, [replace(FOX, strength=strength)])
        weights = (strength * FOX.shares)[:, None, None]
        for name in ("sh0", "shN"):
            wanted = torch.lerp(getattr(BASE, name)[:20], getattr(FOX, name), weights)
            torch.testing.assert_close(getattr(found, name)[:20], wanted)
    whole = compose(BASE, [replace(FOX, shares=torch.ones(20))])
    assert torch.equal(whole.sh0[:20], FOX.sh0) and torch.equal(whole.shN[:20], FOX.shN)
    assert torch.equal(whole.sh0[COUNT:], FOX.canvas.sh0), "a canvas carries its paint"
    loud = compose(BASE, [replace(FOX, strength=1.5)])
    farther = torch.lerp(FOX.canvas_sh0, FOX.canvas.sh0, torch.tensor(1.5))
    torch.testing.assert_close(loud.sh0[COUNT:], farther)


def test_opacities_fade_by_the_factors_and_canvases_appear():
    full = compose(BASE, [FOX]).opacities
    fading = FOX.opacity_factors < 1
    wanted = torch.sigmoid(BASE.opacities[:20]) * FOX.opacity_factors
    torch.testing.assert_close(torch.sigmoid(full[:20]), wanted)
    assert torch.equal(full[:20][~fading], BASE.opacities[:20][~fading])
    assert torch.equal(full[COUNT:], FOX.canvas.opacities)
    half = compose(BASE, [replace(FOX, strength=0.5)]).opacities
    assert torch.equal(half[:COUNT], BASE.opacities), "it fades once half of the canvas is there"
    assert (half[COUNT:] < FOX.canvas.opacities).all()
    strong = compose(BASE, [replace(FOX, strength=1.5)]).opacities
    assert torch.equal(strong, full), "more than all of it is not there"
    nearly = compose(BASE, [replace(FOX, strength=1 - 1e-6)]).opacities
    torch.testing.assert_close(nearly[:COUNT], full[:COUNT], atol=1e-3, rtol=1e-3)


def test_layers_keep_the_mode_that_their_base_is_rendered_in():
    """Files of layers have no mode of their own."""
    scene = with_layers(replace(SCENE, splats=replace(BASE, antialiased=True)), STACK)
    without = (splats_without_paint(scene), without_layers(scene).splats)
    assert all(each.antialiased for each in (scene.splats, scene.unpainted, *without))
    assert not PAINTED.splats.antialiased


def test_a_strength_between_changes_nothing_in_the_others():
    for strength in (0.4, 1.2):
        found = compose(BASE, [replace(FOX, strength=strength), POT])
        rows = torch.cat([ROWS[20:], torch.arange(COUNT + 30, COUNT + 40)])
        assert_equal(found[rows], compose(BASE, [FOX, POT])[rows])


def test_a_layer_above_treats_canvases_as_their_parents():
    above = replace(BOTH, shares=torch.ones(40), opacity_factors=torch.zeros(40))
    found = compose(BASE, [FOX, above])
    canvas = found[torch.arange(COUNT, COUNT + 30)]
    covered = FOX.parents >= 10
    assert covered.any() and not covered.all()
    assert torch.equal(canvas.sh0[covered], above.sh0[FOX.parents[covered] - 10])
    assert (canvas.opacities[covered] < -15).all()
    assert_equal(canvas[~covered], compose(BASE, [FOX])[COUNT:][~covered])


def test_form_adds_relief_to_the_paint():
    painted = replace(FOX, shares=torch.ones(20), settings={**SETTINGS, "form": 0.5}, form=0.5)
    before, after = (compose(BASE, [replace(painted, form=form)]) for form in (0.5, 1.2))
    assert_equal(before, compose(BASE, [replace(painted, relief=0 * FOX.relief)]))
    rows = torch.cat([ROWS[:20], torch.arange(COUNT, COUNT + 30)])
    change = (after.sh0 - before.sh0)[rows] * SH_C0
    torch.testing.assert_close(change, (0.7 * FOX.relief)[:, None, None].expand_as(change))
    others = torch.ones(COUNT + 30, dtype=torch.bool).index_fill(0, rows, False)
    assert_equal(after[others], before[others])


def test_objects_follow_their_gaussians():
    fox = PAINTED.objects["fox"]
    assert torch.equal(fox.picked, family(PAINTED) < 20)
    assert fox.how["gaussians"] == int(fox.picked.sum())
    assert not PAINTED.objects["nothing"].picked.any(), "what was nothing stays"
    faint = with_strengths(PAINTED, {"fox": 0.0})
    assert len(faint.splats) == COUNT + 15
    assert torch.equal(with_strengths(faint, {"fox": 1.0}).objects["fox"].picked, fox.picked)
    new = torch.arange(len(PAINTED.splats)) == COUNT + 35  # of the canvas of the pot
    scene = replace(PAINTED, objects={"dot": SceneObject(new)})
    less = without_layers(scene, ["fox"])
    assert less.objects["dot"].picked.nonzero().tolist() == [[COUNT + 5]]
    assert "dot" not in without_layers(scene, ["pot"]).objects


def test_metrics_of_layers_that_are_gone_are_forgotten():
    scene = replace(PAINTED, metrics={"nnfm": 1, "train": {"psnr": 30.0}})
    assert without_layers(scene, ["fox"]).metrics == {"train": {"psnr": 30.0}}
    assert without_layers(scene).metrics == {"psnr": 30.0}


def test_what_lies_beneath_a_layer():
    for place, layer in enumerate(STACK):
        under, found = beneath(PAINTED, layer.object)
        assert found == place
        assert_equal(under.splats, compose(BASE, STACK[:place]))
    under, place = beneath(PAINTED, "new")
    assert under is PAINTED and place == 3


def test_all_rows_before_show_what_was_there():
    found = splats_without_paint(PAINTED)
    assert len(found) == len(PAINTED.splats)
    assert_equal(found[ROWS], BASE)
    camera = two_cameras()[0]
    one, other = (rasterize(each, camera, backend="reference")[0] for each in (found, BASE))
    torch.testing.assert_close(one, other, atol=1e-5, rtol=0)

"""What changed besides the painted objects: pixels outside of them, and stains by label maps."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, RED, SPLATS, TRAINED, enlarged, write_pictures
from balls import PAINTED_FAST as FAST
from stylesplat.evaluation.changes import farther_than, measure_changes
from stylesplat.evaluation.summary import style_lines
from stylesplat.rendering.weights import coverage
from stylesplat.scene.capture import Capture
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.splats import SH_C0
from stylesplat.stylization.style import Style
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")

VIEWS = enlarged(CAMERAS[::2], 4)  # 192x144
SCENE = replace(TRAINED, cameras=VIEWS, objects={"red": SceneObject(RED, Selection(ids=(3,)))})
MAPS = [3 * (coverage(SCENE.splats, VIEWS[row], RED) > 0.1).long() for row in range(len(VIEWS))]
PHOTOS = [torch.zeros(144, 192, 3, dtype=torch.uint8)] * len(VIEWS)
CAPTURE = Capture(VIEWS, PHOTOS, MAPS)
BESIDE = (SCENE.splats.means - torch.tensor([-0.3, -0.7, 0.0])).norm(dim=1) < 0.35  # of the table
SPILT = SCENE.with_object("red", SceneObject(RED | BESIDE, Selection(ids=(3,))))


@pytest.fixture(scope="module")
def style(tmp_path_factory: pytest.TempPathFactory) -> Style:
    pictures = write_pictures(tmp_path_factory.mktemp("pictures"))
    return Style(pictures[0], config=FAST, steps=8, intensity=1.0)


@pytest.fixture(scope="module")
def spilt(style: Style) -> Scene:
    return stylize(SPILT, {"red": style}, device="cpu")


@pytest.fixture(scope="module")
def clean(style: Style) -> Scene:
    return stylize(SCENE, {"red": style}, device="cpu")


def test_a_stain_on_the_table_is_said(spilt: Scene):
    found = evaluate(spilt, CAPTURE, device="cpu")
    area, view = found["stain_pixels"], found["stain_view"]
    assert spilt.metrics["outside_psnr"] == found["outside_psnr"] == 120, "it is selected"
    assert 200 < area < 2000 and view in VIEWS.names
    (line,) = style_lines(found, ["red"])
    assert line.endswith(f", a stain of {area:,} pixels beside the object in view {view}.")
    assert "stain_pixels" not in evaluate(spilt, device="cpu")


def test_without_one_nothing_else_changed(clean: Scene):
    found = evaluate(clean, CAPTURE, device="cpu")
    assert found["stain_pixels"] == 0 and "stain_view" not in found
    assert style_lines(found, ["red"])[0].endswith(", nothing else changed.")


def test_borders_of_label_maps_may_err_by_a_few_pixels(clean: Scene, spilt: Scene):
    narrower = [labels * farther_than(labels == 0, 3.0) for labels in MAPS]
    assert sum(int((labels > 0).sum()) for labels in narrower) < 0.9 * sum(
        int((labels > 0).sum()) for labels in MAPS
    )
    capture = replace(CAPTURE, label_maps=narrower)
    assert evaluate(clean, capture, device="cpu")["stain_pixels"] == 0
    assert evaluate(spilt, capture, device="cpu")["stain_pixels"] > 200


def test_no_label_map_no_word_of_it(clean: Scene, spilt: Scene):
    grown = {"red": SceneObject(spilt.objects["red"].mask, Selection(ids=(3,), grow=0.2))}
    for scene, capture in (
        (clean, None),
        (clean, replace(CAPTURE, label_maps=None)),
        (clean, replace(CAPTURE, label_maps=[None] * len(VIEWS))),
        (replace(spilt, objects=grown), CAPTURE),
    ):
        found = evaluate(scene, capture, device="cpu")
        assert "stain_pixels" not in found
        assert style_lines(found, ["red"])[0].endswith(", no other Gaussian changed.")


@pytest.mark.parametrize("everything", [False, True])
def test_nothing_changed(everything: bool):
    """Also in a view that shows nothing but the object."""
    picked = torch.full((len(SPLATS),), everything)
    camera = CAMERAS[0].crop([22, 15], [24, 17])
    found = measure_changes(SPLATS, SPLATS, camera, picked)
    assert (found["changed_gaussians"], found["outside_psnr"]) == (0, 120)


def test_what_changed_outside_is_found():
    picked = torch.arange(len(SPLATS)) >= 360  # the last ball
    sh0 = SPLATS.sh0.clone()
    sh0[200:280, :, 2] += 1  # the first ball
    found = measure_changes(SPLATS, replace(SPLATS, sh0=sh0), CAMERAS[:2], picked)
    assert found["changed_gaussians"] == 80
    assert found["outside_max_difference"] == pytest.approx(SH_C0, rel=0.1)  # all but opaque
    assert found["outside_psnr"] < 30


def test_more_gaussians_count_as_changed():
    more = SPLATS[torch.cat([torch.arange(len(SPLATS)), torch.tensor([205, 206])])]
    assert measure_changes(SPLATS, more, CAMERAS[:1], RED)["changed_gaussians"] == 2
    repainted = replace(SPLATS, sh0=SPLATS.sh0 + 1.0 * RED[:, None, None])
    found = measure_changes(SPLATS, repainted, CAMERAS[:1], RED)
    assert found["changed_gaussians"] == 80
    assert found["outside_max_difference"] == 0

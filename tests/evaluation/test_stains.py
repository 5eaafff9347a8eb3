"""Paint beside an object is found where label maps tell where the object is."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from balls import CAMERAS, enlarged
from painted_balls import FAST, RED, TRAINED, write_pictures
from stylesplat.evaluation.in_words import style_lines
from stylesplat.rendering.shares import coverage
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.stylization.style import Style
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")

VIEWS = enlarged(CAMERAS, 4)  # 192x144
SCENE = replace(TRAINED, cameras=VIEWS, objects={"red": SceneObject(RED, {"ids": [3]})})
MAPS = [3 * (coverage(SCENE.splats, VIEWS[row], RED) > 0.1).long() for row in range(len(VIEWS))]
PHOTOS = [torch.zeros(144, 192, 3, dtype=torch.uint8)] * len(VIEWS)
CAPTURE = Capture(VIEWS, PHOTOS, MAPS)
BESIDE = (SCENE.splats.means - torch.tensor([-0.3, -0.7, 0.0])).norm(dim=1) < 0.35  # of the table
SPILT = SCENE.with_object("red", SceneObject(RED | BESIDE, {"ids": [3]}))


@pytest.fixture(scope="module")
def style(tmp_path_factory: pytest.TempPathFactory) -> Style:
    pictures = write_pictures(tmp_path_factory.mktemp("pictures"))
    return Style(pictures[0], config=FAST, steps=8, intensity=1.0)


@pytest.fixture(scope="module")
def spilt(style: Style) -> Scene:
    return stylize(SPILT, {"red": style}, capture=CAPTURE, device="cpu")


@pytest.fixture(scope="module")
def clean(style: Style) -> Scene:
    return stylize(SCENE, {"red": style}, capture=CAPTURE, device="cpu")


def with_maps(change: dict[int, torch.Tensor]) -> Capture:
    return replace(CAPTURE, label_maps=[change.get(row, each) for row, each in enumerate(MAPS)])


def test_a_stain_on_the_table_is_said(spilt: Scene):
    area, view = spilt.metrics["stain_pixels"], spilt.metrics["stain_view"]
    assert spilt.metrics["outside_psnr"] == 120, "it is part of the selection"
    assert 200 < area < 2000 and view in VIEWS.names
    (line,) = style_lines(spilt.metrics, ["red"])
    assert line.endswith(f", a stain of {area:,} pixels beside the object in view {view}.")


def test_without_one_nothing_else_changed(clean: Scene):
    assert clean.metrics["stain_pixels"] == 0 and "stain_view" not in clean.metrics
    assert style_lines(clean.metrics, ["red"])[0].endswith(", nothing else changed.")


def test_evaluate_says_what_stylize_said(spilt: Scene):
    found = evaluate(spilt, CAPTURE, device="cpu")
    names = ("stain_pixels", "stain_view")
    assert [found[name] for name in names] == [spilt.metrics[name] for name in names]
    assert "stain_pixels" not in evaluate(spilt, device="cpu")


def test_a_label_map_that_lost_half_the_object_makes_hardly_a_stain(clean: Scene):
    for row in range(len(MAPS)):
        half = MAPS[row].clone()
        columns = (half == 3).any(dim=0).nonzero()[:, 0]
        half[:, int(columns.float().mean()) :] = 0
        lost = int((half != MAPS[row]).sum())
        found = evaluate(clean, with_maps({row: half}), device="cpu")["stain_pixels"]
        assert found < 0.2 * lost, "few maps show the places at the ball's very side"


def test_borders_of_label_maps_may_err_by_a_few_pixels(clean: Scene, spilt: Scene):
    maps = {}
    for row, labels in enumerate(MAPS):
        inner = cv2.erode(labels.to(torch.uint8).numpy(), np.ones((7, 7), np.uint8))
        maps[row] = torch.from_numpy(inner).long()
    capture = with_maps(maps)
    assert evaluate(clean, capture, device="cpu")["stain_pixels"] == 0
    assert evaluate(spilt, capture, device="cpu")["stain_pixels"] > 200


def test_no_label_map_no_word_of_it(style: Style, tmp_path: Path):
    for scene, capture in (
        (SCENE, None),
        (SCENE, replace(CAPTURE, label_maps=None)),
        (SCENE, replace(CAPTURE, label_maps=[None] * len(VIEWS))),
        (SPILT.with_object("red", SceneObject(RED | BESIDE, {"ids": [3], "grow": 0.2})), CAPTURE),
    ):
        done = stylize(scene, {"red": style}, capture=capture, device="cpu")
        assert "stain_pixels" not in done.metrics
        assert style_lines(done.metrics, ["red"])[0].endswith(", no other Gaussian changed.")


def test_beside_an_object_of_no_label_another_ones_stain_is_found(style: Style):
    """What is selected by its shape counts where it is rendered."""
    blue = torch.arange(len(RED)) >= 360
    scene = SPILT.with_object("blue", SceneObject(blue, {"ids": [], "sphere": ((0, 0.8, 0.3), 1)}))
    done = stylize(scene, {"red": style, "blue": style}, capture=CAPTURE, device="cpu")
    assert done.metrics["stain_pixels"] > 200

"""Options that would have no effect are refused, in a line that names them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from balls import CAMERAS, RED, SPLATS, TRAINED
from scenes import layer_towards
from stylesplat.errors import StyleSplatError
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.scene.scene import Scene
from stylesplat.stylization.config import RecolorConfig
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Recipe, RecoloredObject, Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.export import export
from stylesplat.verbs.render import render
from stylesplat.verbs.select import select
from stylesplat.verbs.sheet import sheet
from stylesplat.verbs.stylize import stylize

SCENE = Scene(SPLATS, CAMERAS)
PLACE: dict[str, Any] = {"sphere": (0.0, 0.0, 0.0, 9.0)}
RECOLORED = Recipe(recolors=(RecoloredObject("red", RecolorConfig(hue=90.0)),))


def painted() -> Scene:
    return TRAINED.with_layers([layer_towards(TRAINED.splats, TRAINED.splats, RED, "red")])


@pytest.mark.parametrize(
    ("idle", "named"),
    [
        ({**PLACE, "model": "anything"}, "--model"),
        ({**PLACE, "threshold": 0.9}, "--threshold"),
        ({**PLACE, "remove_outliers": False}, "--keep-outliers"),
        ({"all": True, "threshold": 0.9}, "--threshold"),
        ({"id": 3, "model": "anything"}, "--model"),
        ({**PLACE, "size": "part"}, "--size"),
    ],
    ids=str,
)
def test_select(idle: dict[str, Any], named: str):
    with pytest.raises(StyleSplatError, match=named):
        select(SCENE, "it", **idle)


@pytest.mark.parametrize("by", [{"id": 3}, {"background": True}], ids=str)
def test_select_takes_a_threshold_where_labels_select(by: dict[str, Any]):
    found = select(SCENE, "it", **by, **PLACE, threshold=0.9, remove_outliers=False)
    assert found.objects["it"].selection.threshold == 0.9


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda file: Style(file, preset="paper", quality="high"), "quality high"),
        (lambda file: render(SCENE, "test", frames=9), "9 frames"),
        (lambda file: render(SCENE, CAMERAS, frames=9), "9 frames"),
        (lambda file: adjust(painted(), 0.5, undo=True), "intensity"),
        (lambda file: adjust(painted(), form=0.5, undo=True), "form"),
        (lambda file: sheet(TRAINED, "red", [file], vary={"steps": [1]}, steps=2), "steps"),
        (
            lambda file: sheet(TRAINED, "red", [file], vary={"scale": [1], "stroke_size": [2]}),
            "scale",
        ),
        (lambda file: stylize(TRAINED, RECOLORED, features="vgg16"), "--features"),
        (lambda file: stylize(TRAINED, RECOLORED, protect="blue"), "--protect"),
        (
            lambda file: export(SPLATS, file.with_suffix(".glb"), mesh=MeshConfig(), objects=["3"]),
            "no objects",
        ),
    ],
)
def test_other_verbs(call: Callable[[Path], object], named: str, tmp_path: Path):
    with pytest.raises(StyleSplatError, match=named):
        call(tmp_path / "wave.png")


def test_a_preset_beside_that_of_the_recipe(tmp_path: Path):
    (tmp_path / "wave.jpg").touch()
    (tmp_path / "r.yaml").write_text("preset: default\nobjects: {vase: {style: wave.jpg}}\n")
    with pytest.raises(StyleSplatError, match="preset default, and paper"):
        read_recipe(tmp_path / "r.yaml", preset="paper")

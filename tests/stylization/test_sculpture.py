"""A form above 1: paint shows the object's form better, within the paint's own tones."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from balls import (
    CAMERAS,
    COUNT,
    LIGHT,
    PAINTED_FAST,
    PICKED,
    TRAINED,
    dense_ball,
    enlarged,
    opened,
    write_pictures,
)
from scenes import layer_towards, rand
from stylesplat.io.scene_folder import save
from stylesplat.rendering.render import rasterize
from stylesplat.scene.layers import Layer, layer_subset
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.stylization import sculpture
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.stylize import stylize, stylize_live

EVERY = torch.ones(COUNT, dtype=torch.bool)
VIEWS = enlarged(CAMERAS, 2)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sculpture, "SCULPTURE_VIEWS", 8)
    monkeypatch.setattr(sculpture, "SCULPTURE_LENGTH", 90.0)


BALL = dense_ball(0.35 * LIGHT)[PICKED]


def with_dark(places: Tensor) -> Scene:
    """A ball that is dark at places, painted with strokes as strong."""
    base = replace(BALL, sh0=torch.where(places[:, None, None], BALL.sh0 - 0.8, BALL.sh0))
    paint = replace(base, sh0=0.6 * (rand(COUNT, 1, 1, seed=3) - 0.5).expand(-1, 1, 3).contiguous())
    scene = Scene(base, VIEWS, objects={"ball": SceneObject(EVERY)})
    layer = layer_towards(base, paint, EVERY, "ball")
    return scene.with_layer(replace(layer, form=1.0, settings={"form": 1.0}))


@pytest.fixture(scope="module")
def painted() -> Scene:
    """A ball with dark spots."""
    return with_dark(torch.sin(9 * BALL.means).prod(dim=1) > 0.3)


def shown_of(scene: Scene) -> Tensor:
    """The luminance of a view, where the ball is."""
    covered = rasterize(scene.base, VIEWS[4])[1][0, ..., 0] > 0.95
    return rasterize(scene.splats, VIEWS[4])[0][0].mean(dim=-1)[covered]


def likeness(scene: Scene) -> float:
    """Correlation of a painted view with that of the base."""
    before = replace(scene, layers=(), composed=None)
    return float(torch.corrcoef(torch.stack([shown_of(scene), shown_of(before)]))[0, 1])


def test_the_form_shows_and_goes_again(painted: Scene):
    half, whole = (adjust(painted, form=form) for form in (1.25, 1.5))
    plain = likeness(painted)
    assert plain + 0.05 < likeness(half) < likeness(whole)
    middle = (painted.splats.sh0 + whole.splats.sh0) / 2
    torch.testing.assert_close(half.splats.sh0, middle)
    back = adjust(whole, form=1.0)
    assert torch.equal(back.splats.sh0, painted.splats.sh0)
    low, high = shown_of(painted).aminmax()
    assert low - 0.15 < shown_of(whole).quantile(0.01)
    assert shown_of(whole).quantile(0.99) < high + 0.15


def test_a_pattern_all_over_comes_back_too(said: list[str]):
    striped = with_dark(torch.sin(60 * BALL.means[:, 2]) > 0)
    assert likeness(adjust(striped, form=1.5)) > likeness(striped) + 0.05
    assert not said
    flat = replace(striped.layers[0], relief=torch.full((COUNT,), 0.005))
    adjust(striped.with_layers([flat]), form=0.5)
    assert any("no detail that stands out" in line for line in said)


def test_it_is_kept_and_known_again(
    painted: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    whole = adjust(painted, form=1.5)
    save(whole, tmp_path / "scene")
    scene = opened(tmp_path / "scene")
    assert torch.equal(scene.splats.sh0, whole.splats.sh0)
    monkeypatch.setattr(sculpture, "sculpt", None)  # it is not made again
    assert likeness(adjust(scene, form=1.4)) > likeness(painted)


def test_a_part_of_a_layer_has_that_of_its_rows(painted: Scene):
    (layer,) = adjust(painted, form=1.5).layers
    places = torch.arange(COUNT).flip(0)
    places[::2] = -1
    part = layer_subset(layer, places)
    assert layer.sculpture is not None and part.sculpture is not None
    assert torch.equal(part.sculpture, layer.sculpture[places >= 0])


def test_a_layer_of_an_earlier_version_shows_as_it_did(painted: Scene):
    """Its relief went on above 1, until its form is changed."""
    (layer,) = painted.layers
    relief = rand(COUNT, seed=7)

    def shown(layer: Layer) -> Scene:
        return painted.with_layers([layer])

    old = shown(replace(layer, relief=relief, form=1.4))
    expected = layer.sh0[:, 0, 0] + 0.4 * relief / 0.28209479177387814
    torch.testing.assert_close(old.splats.sh0[:, 0, 0], expected)
    assert adjust(old, form=1.2).layers[0].sculpture is not None
    without = adjust(old, form=0.5)
    assert torch.equal(
        without.splats.sh0, shown(replace(layer, relief=relief, form=0.5)).splats.sh0
    )


def test_painting_with_more_form_is_painting_and_adjusting(tmp_path: Path):
    picture, _ = write_pictures(tmp_path)

    def style(form: float) -> Style:
        return Style(picture, config=replace(PAINTED_FAST, quality="draft", form=form))

    options = {"device": "cpu", "measured": False}
    once = stylize(TRAINED, {"red": style(1.4)}, **options)
    twice = adjust(stylize(TRAINED, {"red": style(1.0)}, **options), form=1.4)
    (layer,) = once.layers
    assert layer.form == 1.4 and layer.painted_form == 1 and layer.sculpture is not None
    assert torch.equal(once.splats.sh0, twice.splats.sh0)
    *_, live = stylize_live(TRAINED, "red", style(1.4), device="cpu")
    assert torch.equal(live.scene().splats.sh0, once.splats.sh0)
    assert live.state.step == live.state.steps

"""What each part of the objective does to an object, and that it asks nothing of the rest."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from balls import CAMERAS, cropped
from balls import RED as PICKED
from balls import STRIPED_SCENE as SCENE
from scenes import rand, randn
from stylesplat.imaging.color import build_palette
from stylesplat.rendering.render import rasterize
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.form import FormSurvey
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.optimize import (
    LARGE_SHAPE_SIDE,
    Objective,
    content_weight,
    optimize_colors,
)
from stylesplat.stylization.views import (
    ObjectView,
    find_boxes,
    total_weights,
    typical_length,
)

CONFIG = StyleConfig(block=2, lr=0.05, form=0.0)
EVERYTHING = replace(CONFIG, content=1.0, form=1.0)
COLORS = SCENE.sh0[PICKED, 0]
ZOOM = 2.0
STEPS = 25


@pytest.fixture(scope="module", params=[1e9, 0.0], ids=["linear", "rasterised"])
def views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    return views_within(request.param, network)


def views_within(max_memory: float, network: FeatureNetwork) -> list[ObjectView]:
    boxes = find_boxes(SCENE, CAMERAS[:3], PICKED)
    return cropped(SCENE, boxes, PICKED, network, zoom=ZOOM, max_memory=max_memory)


@pytest.fixture
def objective(network: FeatureNetwork) -> Objective:
    style = rand(200, 12, seed=1)
    length = ZOOM * typical_length(find_boxes(SCENE, CAMERAS[:3], PICKED))
    form = FormSurvey(
        (0.0, 0.0), (0.0, 1.0), torch.zeros(3)
    )  # its views are too small for finer detail
    return Objective(network, build_index(style, torch.float32), CONFIG, length, form)


def with_settings(objective: Objective, **settings: float) -> Objective:
    return replace(objective, config=replace(objective.config, **settings))


def extra(
    objective: Objective, view: ObjectView, colors: Tensor, begun: Tensor | None = None
) -> float:
    """What is added to the style's part."""
    (target,) = objective.targets([view], SCENE, begun)
    style, total, _ = objective(target, view.render(colors))
    return float(total - style)


def optimised(objective: Objective, views: list[ObjectView], **settings: float) -> Tensor:
    """The colours of the object after some steps."""
    objective = with_settings(objective, **settings)
    targets = objective.targets(views, SCENE, None)
    *_, (last, _) = optimize_colors(COLORS, targets, objective, STEPS, seed=0)
    return last


def recolored(seed: int = 2) -> Tensor:
    """Other colours of the object."""
    return COLORS + randn(*COLORS.shape, seed=seed)


@pytest.mark.parametrize("setting", ["content", "form"])
def test_content_keeps_features_and_form_the_luminance_that_stands_out(
    objective: Objective, views: list[ObjectView], setting: str
):
    def distance(colors: Tensor) -> float:
        measure = with_settings(objective, **{setting: 1.0})
        return sum(extra(measure, view, colors) for view in views)

    free, kept = (distance(optimised(objective, views, **{setting: s})) for s in (0.0, 1.0))
    assert kept < (0.5 if setting == "content" else 0.9) * free


def test_content_and_form_compare_with_the_highlights_that_were_there(
    objective: Objective, views: list[ObjectView]
):
    """The views of the paint have none."""
    content, view = with_settings(objective, content=1.0), views[0]
    (target,) = content.targets([view], SCENE, None)
    style, free, _ = content(target, view.render(COLORS))
    assert free > style + 1e-4
    style, kept, _ = content(target, rasterize(SCENE, view.camera)[0][0])
    assert float(kept - style) == pytest.approx(0, abs=1e-6)


def test_large_shapes_stay_and_detail_is_free(objective: Objective, views: list[ObjectView]):
    """Of the object; what lies outside of it has no say."""
    view = views[0]
    (target,) = objective.targets([view], SCENE, COLORS)
    assert target.shapes is not None
    assert extra(objective, view, COLORS, COLORS) == pytest.approx(0, abs=1e-6)
    image = view.render(COLORS)
    height, width = image.shape[:2]
    waves = torch.tensor([0.1, -0.1]).repeat(LARGE_SHAPE_SIDE // 2)
    fine = waves.repeat(width // LARGE_SHAPE_SIDE + 1)[:width].expand(height, width)[..., None]

    def change(shown: Tensor) -> float:
        style, total, _ = objective(target, shown)
        return float(total - style)

    everywhere = change(image + 0.1)
    assert change(image + fine) < 0.2 * everywhere, "but for the contour"
    assert change(torch.where(view.pixels[..., None], image, image + 0.1)) == pytest.approx(
        0, abs=1e-6
    )


def test_the_parts_add_up(objective: Objective, views: list[ObjectView]):
    view, styled, begun = views[0], recolored(), recolored(3)
    content = extra(with_settings(objective, content=1.0), view, styled)
    form = extra(with_settings(objective, form=1.0), view, styled)
    shapes = extra(objective, view, styled, begun)
    grey = torch.linspace(0, 1, 500)[:, None].expand(500, 3)
    near = replace(objective, palette=build_palette(grey))
    colors = extra(near, view, styled)
    assert min(content, form, shapes, colors) > 0
    all_of_them = with_settings(near, content=0.5, form=1.5)
    weight = content_weight(0.5) / content_weight(1.0)
    expected = weight * content + 1.5 * form + shapes + colors
    assert extra(all_of_them, view, styled, begun) == pytest.approx(expected, rel=1e-4)


def test_linear_views_give_the_gradient_of_rendering(objective: Objective, network: FeatureNetwork):
    full = replace(objective, config=EVERYTHING)
    gradients = []
    for memory in (1e9, 0.0):
        view = views_within(memory, network)[0]
        (target,) = full.targets([view], SCENE, recolored(3))
        leaf = COLORS.clone().requires_grad_()
        full(target, view.render(leaf))[1].backward()
        assert leaf.grad is not None
        gradients.append(leaf.grad)
    linear, rendered = gradients
    assert (linear - rendered).norm() / rendered.norm() < 2e-2  # weights are float16


def test_those_that_hardly_show_take_small_steps(views: list[ObjectView], objective: Objective):
    weights = total_weights(views)
    targets = objective.targets(views, SCENE, None)
    *_, (last, _) = optimize_colors(COLORS, targets, objective, 1, seed=0)
    steps = (last - COLORS).abs().amax(dim=1)
    ranked = weights.argsort()
    assert steps[ranked[:20]].mean() < 0.5 * steps[ranked[-20:]].mean()

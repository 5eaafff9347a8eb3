"""What each part of the objective does to an object, and that it asks nothing of the rest."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.sh import SH_C0
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.object_views import ObjectView, cut_views, find_boxes
from stylesplat.stylization.objective import Objective, content_weight, total_variation
from stylesplat.stylization.optimize import optimize_colors
from stylesplat.stylization.style_config import StyleConfig

PICKED = (torch.arange(len(SPLATS)) >= 200) & (torch.arange(len(SPLATS)) < 280)
SCENE = replace(
    SPLATS, shN=0.1 * torch.randn(len(SPLATS), 3, 3, generator=torch.Generator().manual_seed(0))
)
CONFIG = StyleConfig(layers=(2,), lr=0.05)
STEPS = 25


@pytest.fixture(scope="module", params=[1e9, 0.0], ids=["linear", "rasterised"])
def views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    return views_within(request.param, network)


def views_within(max_memory: float, network: FeatureNetwork) -> list[ObjectView]:
    boxes = find_boxes(SCENE, CAMERAS[:3], PICKED)
    cells = [network.cells(2)]
    return cut_views(SCENE, boxes, PICKED, cells, zoom=2.0, max_memory=max_memory)


@pytest.fixture
def objective(network: FeatureNetwork) -> Objective:
    style = torch.rand(200, 12, generator=torch.Generator().manual_seed(1))
    index = build_index(style, torch.float32)
    return Objective(network, [index], SCENE, CONFIG)


def optimised(objective: Objective, views: list[ObjectView], **settings: float) -> torch.Tensor:
    """The constant bands of the object after some steps."""
    objective = replace(objective, config=replace(objective.config, **settings))
    *_, last = optimize_colors(SCENE, SCENE, PICKED.float(), views, objective, STEPS)
    return last.splats.sh0


def test_content_keeps_the_features(objective: Objective, views: list[ObjectView]):
    def change(sh0: torch.Tensor) -> float:
        measure = replace(objective, config=replace(CONFIG, content=1.0))
        losses = [measure(view, replace(SCENE, sh0=sh0)) for view in views]
        return float(sum(loss.total - loss.style for loss in losses))

    assert change(SCENE.sh0) == pytest.approx(0, abs=1e-6)  # bands are fixed with a rounding
    assert change(optimised(objective, views, content=1.0)) < 0.5 * change(
        optimised(objective, views)
    )


def test_content_compares_with_the_highlights_that_were_there(
    objective: Objective, views: list[ObjectView]
):
    """Even if they are painted over by then, and views are fixed to that."""
    content = replace(objective, config=replace(CONFIG, content=1.0))
    matte = replace(SCENE, shN=torch.zeros_like(SCENE.shN))
    for view in views:
        free, fixed = content(view, matte), content(view.with_fixed_bands(matte), matte)
        assert float(fixed.total) == pytest.approx(float(free.total), rel=1e-3)
        assert free.total > free.style + 1e-4


def test_features_that_do_not_fit_are_not_remembered(objective: Objective, views: list[ObjectView]):
    content = replace(objective, config=replace(CONFIG, content=1.0), wanted={})
    without, styled = replace(content, room=0.0, wanted={}), replace(SCENE, sh0=-SCENE.sh0)
    for view in views:
        assert without(view, styled).total == content(view, styled).total
    assert not without.wanted and len(content.wanted) == len(views)


def test_smoothness_lowers_the_variation(objective: Objective, views: list[ObjectView]):
    def variation(sh0: torch.Tensor) -> float:
        styled = replace(SCENE, sh0=sh0)
        total = 0.0
        for view in views:
            mask = coverage(SCENE, view.camera, PICKED) > COVERED
            total += float(total_variation(view.render(styled), mask))
        return total

    flat = variation(optimised(objective, views, smoothness=30.0))
    assert flat < 0.9 * variation(optimised(objective, views))
    assert flat < variation(SCENE.sh0)


def test_the_parts_add_up(objective: Objective, views: list[ObjectView]):
    def losses(**settings: float) -> tuple[float, float]:
        found = replace(objective, config=replace(CONFIG, **settings))(views[0], styled)
        return float(found.style), float(found.total)

    generator = torch.Generator().manual_seed(2)
    styled = replace(SCENE, sh0=SCENE.sh0 + torch.randn(SCENE.sh0.shape, generator=generator))
    style, total = losses()
    assert style == total
    content, smooth = losses(content=1.0)[1] - style, losses(smoothness=1.0)[1] - style
    assert content > 0 < smooth
    both = losses(content=0.5, smoothness=3.0)
    weight = content_weight(0.5) / content_weight(1.0)
    assert both == (style, pytest.approx(style + weight * content + 3 * smooth, rel=1e-4))


def test_more_content_counts_for_more_up_to_1():
    weights = [content_weight(share / 20) for share in range(21)]
    assert weights[0] == 0
    assert weights == sorted(set(weights))
    assert content_weight(2.0) == content_weight(1.0) < float("inf")


def test_total_variation():
    ramp = torch.arange(6.0)[None, :, None].expand(5, 6, 3) / 10
    mask = torch.ones(5, 6, dtype=torch.bool)
    # 4 * 6 vertical pairs of difference 0, 5 * 5 horizontal ones of 0.1
    assert float(total_variation(ramp, mask)) == pytest.approx(0.1 * 25 / 49)
    edge = ramp.clone()
    edge[:, 3:] += 9
    mask[:, 3] = False
    assert float(total_variation(edge, mask)) == pytest.approx(0.1 * 15 / 35, abs=1e-6)  # of 9


def test_the_background_stays_to_the_bit(objective: Objective, views: list[ObjectView]):
    sh0 = optimised(objective, views, content=1.0, smoothness=1.0)
    assert torch.equal(sh0[~PICKED], SCENE.sh0[~PICKED])
    assert (sh0[PICKED] != SCENE.sh0[PICKED]).any()


def test_linear_views_give_the_object_the_gradient_of_rendering_and_others_none(
    objective: Objective, network: FeatureNetwork
):
    """Others lie before or behind the object."""
    full = replace(objective, config=replace(CONFIG, content=1.0, smoothness=1.0))
    gradients = []
    for memory in (1e9, 0.0):
        leaf = SCENE.sh0.clone().requires_grad_()
        full(views_within(memory, network)[0], replace(SCENE, sh0=leaf)).total.backward()
        assert leaf.grad is not None
        gradients.append(leaf.grad)
    linear, rendered = gradients
    assert rendered[~PICKED].any() and not linear[~PICKED].any()
    error = (linear - rendered)[PICKED].norm() / rendered[PICKED].norm()
    assert error < 1e-2


def test_what_is_far_from_the_object_has_no_say(
    objective: Objective, views: list[ObjectView], monkeypatch: pytest.MonkeyPatch
):
    full = replace(objective, config=replace(CONFIG, content=1.0, smoothness=1.0))
    view = views[0]
    image = rasterize(SCENE, view.camera)[0][0].requires_grad_()
    monkeypatch.setattr(ObjectView, "render", lambda *_, **__: image)
    full(view, SCENE).total.backward()
    assert image.grad is not None
    cells = view.cells[0].nonzero()
    spanned = torch.zeros(image.shape[:2], dtype=torch.bool)
    for row, column in (cells * 2 - 4).clamp(min=0).tolist():
        spanned[row : row + 10, column : column + 10] = True
    assert not image.grad[~spanned].any()
    assert spanned.any() and not spanned.all() and image.grad[spanned].any()


def test_those_that_hardly_show_take_small_steps(views: list[ObjectView], objective: Objective):
    weights = sum(view.weights(SCENE, PICKED) for view in views)
    assert isinstance(weights, torch.Tensor)
    assert not weights[~PICKED].any()
    *_, last = optimize_colors(SCENE, SCENE, PICKED.float(), views, objective, 1)
    steps = (last.splats.sh0 - SCENE.sh0).abs().amax(dim=(1, 2))[PICKED] * SH_C0
    ranked = weights[PICKED].argsort()
    assert steps[ranked[:20]].mean() < 0.5 * steps[ranked[-20:]].mean()

"""A canvas covers its object, shows nowhere else, and hides what lies beneath."""

import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, ROWS, SPLATS, enlarged, same
from balls import RED as PICKED
from stylesplat.imaging.similarity import psnr
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import colors_and_coverage, coverage
from stylesplat.scene.layers import compose
from stylesplat.scene.splats import Splats
from stylesplat.stylization.canvas import (
    Canvas,
    PaintState,
    build_surfels,
    drop_hidden,
    fit_surfels,
    layer_of,
)
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.guides import LONG, align_to_strokes
from stylesplat.stylization.painting import Painting
from stylesplat.stylization.trim import trim_surfels
from stylesplat.stylization.views import ObjectBox, find_boxes

FINE = enlarged(CAMERAS, 4)
LENGTH, ROOM = 60.0, 1500
# What discs hide may let through what reaches pixels that it had finished: below MIN_TRANSMITTANCE
UNSEEN = 1e-4
SOLID = replace(SPLATS, opacities=torch.full_like(SPLATS.opacities, 6.0))


@pytest.fixture(scope="module")
def boxes() -> list[ObjectBox]:
    return find_boxes(SOLID, FINE, PICKED)


def canvas_on(splats: Splats, boxes: list[ObjectBox], **changes) -> Canvas | None:
    options = {"length": LENGTH, "max_discs": ROOM, "seed": 0} | changes
    return build_surfels(splats, PICKED, boxes, **options)


@pytest.fixture(scope="module")
def fitted(boxes: list[ObjectBox]) -> Canvas:
    """Laid and fitted, so that it may show beside the object."""
    canvas = canvas_on(SOLID, boxes)
    assert canvas is not None
    return fit_surfels(canvas, seed=0)


@pytest.fixture(scope="module")
def laid(fitted: Canvas) -> Canvas:
    return trim_surfels(fitted, FINE)[0]


def painted_with_stripes(canvas: Canvas) -> Splats:
    """Its discs in stripes, for strokes to turn along."""
    level = (canvas.splats.means[:, 2] / (3 * canvas.spacing)).sin()
    sh0 = canvas.splats.sh0.clone()
    sh0[canvas.is_disc] = level[canvas.is_disc, None, None]
    return replace(canvas.splats, sh0=sh0)


def spilled(canvas: Canvas) -> float:
    """The most that an object covers where nothing of it showed before."""
    shown = []
    for index in range(len(FINE)):
        nothing = coverage(SOLID, FINE[index], PICKED) == 0
        shown.append(coverage(canvas.splats, FINE[index], canvas.mask)[nothing].max())
    return float(max(shown))


def test_discs_cover_the_object_and_look_like_it(laid: Canvas):
    shares = []
    for index in range(len(FINE)):
        before, covered = colors_and_coverage(SOLID, FINE[index], PICKED)
        after, _ = colors_and_coverage(laid.splats, FINE[index], laid.is_disc)
        inside = covered[..., 0] > 0.98
        shares.append(float(coverage(laid.splats, FINE[index], laid.is_disc)[inside].mean()))
        assert psnr(after[inside], before[inside]) > 23
    assert min(shares) > 0.6 and sum(shares) / len(shares) > 0.7, shares


def test_nothing_shows_where_nothing_of_the_object_did(fitted: Canvas):
    """Discs that show there become smaller or go; most stay as they are."""
    scales = fitted.splats.scales + math.log(1.3) * fitted.is_disc[:, None]
    swollen = fitted.changed(scales=scales)
    assert spilled(swollen) > 100 * UNSEEN, "else the check is worth nothing"
    confined, kept = trim_surfels(swollen, FINE)
    assert spilled(confined) < UNSEEN
    assert (~kept).sum() < 0.3 * fitted.is_disc.sum()
    same_size = (confined.splats.scales == swollen.splats.scales[kept]).all(dim=1)
    assert 0.8 < same_size.float().mean() < 1


def test_nor_do_discs_along_strokes_show_there(fitted: Canvas):
    along = painted_with_stripes(fitted)
    turned, kept = trim_surfels(fitted, FINE, painted=along)
    free = align_to_strokes(along, fitted.is_disc, fitted.spacing)
    assert spilled(replace(fitted, splats=free)) > 50 * UNSEEN
    assert spilled(turned) < UNSEEN
    plain, discs = fitted.splats[kept][turned.is_disc], turned.splats[turned.is_disc]
    longer = (discs.scales - plain.scales)[:, 0]
    assert longer.median() > 0.3 and longer.max() < math.log(LONG) + 1e-4
    assert not torch.equal(discs.quats, plain.quats)
    assert torch.equal(turned.splats.sh0, fitted.splats.sh0[kept]), "paint is not the canvas's"


def test_others_stay_and_the_objects_rows_only_fade(laid: Canvas):
    for name, before in SOLID.tensors().items():
        after = laid.splats.tensors()[name][: len(SOLID)]
        assert torch.equal(after[~PICKED], before[~PICKED]), name
        assert torch.equal(after, before) == (name != "opacities"), name
    opacities = laid.splats.opacities[: len(SOLID)]
    assert (opacities <= SOLID.opacities + 1e-4).all()
    assert torch.equal(laid.parents[: len(SOLID)], ROWS)
    assert PICKED[laid.parents].sum() == PICKED.sum() + len(laid.parents) - len(SOLID)


def test_it_fades_in_as_strongly_as_is_wanted(laid: Canvas):
    count = len(SOLID)
    before = laid.changed(
        opacities=torch.where(laid.is_disc, -20.0, laid.before.opacities[laid.parents])
    ).splats
    sh0 = laid.splats.sh0.clone()
    sh0[count:] = -sh0[count:]  # any other colours
    after = replace(laid.splats, sh0=sh0)
    state = PaintState(1, 1, torch.zeros(()), after, laid, torch.zeros(len(after)))
    layer = layer_of(state, Painting("ball", PICKED, (), StyleConfig()))
    for index in (0, 3):
        first, last = (rasterize(s, FINE[index])[0][0] for s in (before, after))
        assert torch.equal(first, rasterize(SOLID, FINE[index])[0][0])
        whole = last - first
        for share in (0.1, 0.25, 0.5, 0.75, 0.9, 1.0):
            mixed = compose(SOLID, [replace(layer, strength=share)]).splats
            change = rasterize(mixed, FINE[index])[0][0] - first
            assert (change * whole).sum() / whole.square().sum() == pytest.approx(share, abs=0.1)
    beyond = compose(SOLID, [replace(layer, strength=1.5)]).splats
    torch.testing.assert_close(beyond.opacities, after.opacities, atol=1e-3, rtol=1e-4)
    assert torch.equal(beyond.opacities[count:], after.opacities[count:])
    torch.testing.assert_close(beyond.sh0[count:], -2 * laid.splats.sh0[count:])


def test_the_room_is_nearly_used_and_the_seed_decides_how(fitted: Canvas, boxes: list[ObjectBox]):
    small = canvas_on(SOLID, boxes, max_discs=300)
    again, other = canvas_on(SOLID, boxes), canvas_on(SOLID, boxes, seed=1)
    assert small is not None and again is not None and other is not None
    assert 130 < small.is_disc.sum() <= 300
    assert not same(other.splats, again.splats)
    once, shuffled = (fit_surfels(again, seed=seed) for seed in (0, 1))
    assert same(once.splats, fitted.splats) and not same(shuffled.splats, fitted.splats)


def test_smoke_has_no_surface(boxes: list[ObjectBox]):
    smoke = replace(SPLATS, opacities=torch.full_like(SPLATS.opacities, -3.0))
    assert canvas_on(smoke, boxes) is None


def test_discs_that_no_view_shows_go(fitted: Canvas):
    """A second layer inside; the first one stays."""
    inner = fitted.splats[fitted.is_disc]
    centre = SOLID.means[PICKED].mean(dim=0)
    inner = replace(inner, means=centre + 0.5 * (inner.means - centre))
    twice = replace(
        fitted,
        splats=Splats.cat([fitted.splats, inner]),
        parents=torch.cat([fitted.parents, fitted.parents[fitted.is_disc]]),
    )
    left, count = drop_hidden(twice, LENGTH), int(fitted.is_disc.sum())
    assert 0.9 * count < left.is_disc.sum() < 1.1 * count
    assert drop_hidden(twice, 100 * LENGTH).is_disc.sum() > left.is_disc.sum()

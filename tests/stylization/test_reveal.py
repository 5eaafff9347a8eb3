"""Discs that close what was open go, and what they hid comes back; a solid object stays whole."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, enlarged
from scenes import cloud
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.canvas import Canvas, build_surfels
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.painter import paint
from stylesplat.stylization.trim import close_gaps, reveal, split_large
from stylesplat.stylization.views import find_boxes, typical_length

VIEWS = enlarged(CAMERAS, 4)


def plate(*, holes: bool) -> Splats:
    """A square of small Gaussians, with a grid of square holes."""
    axis = torch.linspace(-0.8, 0.8, 81)
    x, z = (each.flatten() for each in torch.meshgrid(axis, axis, indexing="ij"))
    is_hole = ((x * 2.5) % 1 < 0.5) & ((z * 2.5) % 1 < 0.5) & (x.abs() < 0.7) & (z.abs() < 0.7)
    solid = ~is_hole if holes else torch.ones_like(is_hole)
    means = torch.stack([x, 0 * x, z], dim=1)[solid]
    return cloud(means, 0.012, opacity=4.0)


def laid(splats: Splats) -> tuple[Canvas, list, float]:
    mask = torch.ones(len(splats), dtype=torch.bool)
    boxes = find_boxes(splats, VIEWS, mask)
    length = typical_length(boxes)
    canvas = build_surfels(splats, mask, boxes, length=length, max_discs=20_000, seed=0)
    assert canvas is not None
    return canvas, boxes, length


def shares(splats: Splats, before: Splats, camera: Cameras) -> tuple[float, float]:
    """How much of what was open is covered, and of what was covered."""
    was, now = (coverage(each, camera) > COVERED for each in (before, splats))
    near = coverage(plate(holes=False), camera) > COVERED
    return float(now[near & ~was].float().mean()), float(now[was].float().mean())


def closed(canvas: Canvas) -> Canvas:
    """With discs twice as large, which close the holes."""
    return canvas.changed(scales=canvas.splats.scales + canvas.is_disc[:, None] * 1.2)


def test_holes_open_again_and_the_rest_stays():
    splats = plate(holes=True)
    canvas, boxes, length = laid(splats)
    canvas = closed(canvas)
    shown, kept = reveal(canvas, boxes, length, has_parts=False)
    assert len(shown.splats) == kept.sum() and kept[: len(splats)].all()
    open_before, open_after = (shares(c.splats, splats, VIEWS[1]) for c in (canvas, shown))
    assert open_before[0] > 0.6
    assert open_after[0] < 0.13 and open_after[1] > 0.95


def test_a_solid_object_keeps_its_canvas():
    splats = plate(holes=False)
    canvas, boxes, length = laid(splats)
    shown, kept = reveal(canvas, boxes, length, has_parts=False)
    assert kept.float().mean() > 0.9
    assert shares(shown.splats, splats, VIEWS[1])[1] > 0.95


def test_no_hole_is_left_in_what_was_solid():
    """Small ones between discs, before Gaussians that are far wider."""
    axis = torch.linspace(-0.8, 0.8, 17)
    x, z = (each.flatten() for each in torch.meshgrid(axis, axis, indexing="ij"))
    splats = cloud(torch.stack([x, 0 * x, z], dim=1), 0.1, opacity=2.0)
    splats.scales[:, 1] = -6.0  # flat, in the plane of the plate
    canvas, boxes, length = laid(splats)
    holes = torch.tensor([[-0.3, 0.0, 0.2], [0.1, 0.0, -0.3], [0.4, 0.0, 0.3]])
    far = torch.cdist(canvas.splats.means, holes).amin(dim=1) > 0.05
    shown, _ = reveal(canvas.select(far | ~canvas.is_disc), boxes, length, has_parts=False)
    was, now = (coverage(each, VIEWS[1]) for each in (splats, shown.splats))
    assert now[was > 0.9].min() > 0.6


def test_what_looks_otherwise_comes_back_where_an_object_has_parts():
    """A letter on a sign, over which discs have the colour of the sign."""
    splats = plate(holes=False)
    is_letter = (splats.means[:, 0].abs() < 0.05) & (splats.means[:, 2].abs() < 0.4)
    sh0 = torch.where(is_letter[:, None, None], -1.5, 1.0).expand(-1, 1, 3).contiguous()
    splats = replace(splats, sh0=sh0)
    canvas, boxes, length = laid(splats)
    plain = torch.where(canvas.is_disc[:, None, None], 1.0, canvas.splats.sh0)
    for has_parts in (True, False):
        shown, _ = reveal(canvas.changed(sh0=plain), boxes, length, has_parts=has_parts)
        opacities = torch.sigmoid(shown.splats.opacities[: len(splats)])[is_letter]
        assert (opacities.mean() > 0.5) == has_parts


def test_discs_beside_a_gap_widen_and_no_others():
    splats = plate(holes=False)
    canvas, boxes, length = laid(splats)
    away = canvas.splats.means[:, 0].abs()
    faded = canvas.splats.opacities.masked_fill(~canvas.is_disc & (away < 0.1), -20.0)
    slit = canvas.changed(opacities=faded).select(~canvas.is_disc | (away > 0.03))
    closed = close_gaps(slit, boxes, length)
    was, before, after = (coverage(each, VIEWS[1]) for each in (splats, slit.splats, closed.splats))
    lost_before, lost_after = ((was > 0.9) & (was - now > 0.2) for now in (before, after))
    assert lost_before.sum() > 50
    assert lost_after.sum() < 0.5 * lost_before.sum()
    changed = (closed.splats.scales != slit.splats.scales).any(dim=1)
    away = slit.splats.means[:, 0].abs()
    assert changed[slit.is_disc & (away < 0.05)].float().mean() > 0.9
    assert not changed[away > 0.1].any()


def test_large_gaussians_that_show_are_split_into_discs_of_their_colours():
    """One half of a plate is a few large ones, which no disc covers."""
    fine = plate(holes=False)
    axis = torch.arange(-0.75, 0.8, 0.25)
    x, z = (each.flatten() for each in torch.meshgrid(axis, axis, indexing="ij"))
    wide = cloud(torch.stack([x, 0 * x, z], dim=1)[x > 0.1], 0.12, opacity=2.0)
    wide.scales[:, 1] = -6.0  # flat, in the plane of the plate
    reds = torch.linspace(-1, 1, len(wide))[:, None, None] * torch.tensor([1.0, 0.0, 0.0])
    splats = Splats.cat([fine[fine.means[:, 0] < -0.1], replace(wide, sh0=reds)])
    canvas, _, length = laid(splats)
    in_left = canvas.splats.means[:, 0] < 0
    shown = canvas.select(in_left | ~canvas.is_disc)  # the wide ones show
    opacities = torch.cat([splats.opacities, shown.splats.opacities[len(splats) :]])
    shown = shown.changed(opacities=opacities)
    split, sources = split_large(shown, length, seed=0)
    assert len(sources) == len(split.splats) > len(shown.splats) + 100
    assert torch.equal(split.splats.sh0, shown.splats.sh0[sources])
    was_large = torch.arange(len(splats)) >= len(splats) - len(wide)
    assert (split.splats.opacities[: len(splats)][was_large] < -10).all()
    assert (split.splats.opacities[: len(splats)][~was_large] > -10).all()
    assert (split.splats.scales[len(shown.splats) :].exp() < 0.06).all()
    before, after = (rasterize(each.splats, VIEWS[1])[0] for each in (shown, split))
    assert (before - after).square().mean().sqrt() < 0.05


@pytest.mark.usefixtures("quick_painting")
def test_an_object_of_few_pixels_stays_solid():
    """A plate of flat Gaussians that is 20 pixels long is painted as if it were larger."""
    axis = torch.linspace(-0.6, 0.6, 13)
    x, z = (each.flatten() for each in torch.meshgrid(axis, axis, indexing="ij"))
    splats = cloud(torch.stack([x, 0 * x, z], dim=1), 0.1, opacity=2.0)
    splats.scales[:, 1] = -6.0  # flat, in the plane of the plate
    style = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))
    config = StyleConfig(block=1, steps=12)
    painted = paint(
        splats, CAMERAS, torch.ones(len(splats), dtype=torch.bool), style, config=config
    )
    assert len(painted) > len(splats) + 500, "on a canvas"
    was, now = (coverage(each, VIEWS[0]) for each in (splats, painted))
    assert (now[was > 0.9] > 0.6).float().mean() > 0.95

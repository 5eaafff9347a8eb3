"""Painting as published (StyleSplat, Jain et al. 2024, section 3.4): NNFM alone.

It optimises all colour bands of every picked Gaussian, at the photos' size, in a quarter of the
views, at a constant rate. There is no canvas, and the object's colours are where they start.
"""

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.rendering.render import colors_of, rasterize
from stylesplat.scene.sequences import evenly_spaced, shuffled_repeats
from stylesplat.scene.splats import Splats
from stylesplat.stylization.canvas import Canvas, PaintState
from stylesplat.stylization.form import form_relief, survey_detail
from stylesplat.stylization.optimize import stage_objective
from stylesplat.stylization.painting import Painting, PaintSetup
from stylesplat.stylization.style import KEPT_HUES, style_pictures
from stylesplat.stylization.views import (
    WHOLE_VIEWS,
    ObjectView,
    PaintView,
    require_boxes,
    stage_views,
    typical_length,
    whole_views,
)
from stylesplat.training.adam import Moments, adam_step

VIEWS_USED = 0.25  # share of the views
SHN_SLOWDOWN = 20  # ratio of the rates of sh0 and shN in the official code


def paint_as_published(setup: PaintSetup, painting: Painting) -> Iterator[PaintState]:
    """Paint an object as the paper does; see `painter.paint_object`."""
    config, splats, mask = painting.config, setup.splats, painting.mask
    every = require_boxes(setup, painting)
    boxes = evenly_spaced(every, math.ceil(VIEWS_USED * len(every)))
    detail = survey_detail(splats, mask, boxes)
    (stage,) = config.stages(typical_length(boxes))
    rows, generator = mask.nonzero()[:, 0], torch.Generator().manual_seed(config.seed)
    views = stage_views(setup, painting, boxes, stage, generator)
    whole, length = whole_views(setup, painting, boxes, stage, WHOLE_VIEWS, views)
    relief = torch.zeros_like(splats.opacities)
    relief[rows] = form_relief(splats, whole, len(rows), length, detail).sum(dim=1)
    share, own = KEPT_HUES.get(config.color, 0.0), None
    if share > 0:
        own = torch.cat([render_bands(view, splats).detach()[view.pixels] for view in whole])
    images = style_pictures(painting.images, config, own, share)
    objective = stage_objective(setup, config, images, stage, detail, None, balanced=False)
    targets, canvas = objective.targets(views, splats, None), Canvas.without_discs(splats, mask)
    leaves = {name: splats.tensors()[name][rows].requires_grad_() for name in ("sh0", "shN")}
    rates = {"sh0": config.lr, "shN": config.lr / SHN_SLOWDOWN}
    moments, potentials = Moments.zeros(leaves), None
    generator = torch.Generator().manual_seed(config.seed)
    for step, target in enumerate(shuffled_repeats(targets, stage.steps, generator), start=1):
        with torch.enable_grad():  # the caller may have disabled it
            image = render_bands(target.view, splats.with_rows(rows, leaves))
            nnfm, total, potentials = objective(target, image, potentials)
            total.backward()
        adam_step(leaves, moments, rates, step)
        for leaf in leaves.values():
            leaf.grad = None
        painted = splats.with_rows(rows, leaves).detach()
        yield PaintState(step, stage.steps, nnfm.detach(), painted, canvas, relief, every)


def render_bands(view: PaintView, splats: Splats) -> Float[Tensor, "H W 3"]:
    """Render splats that differ from the view's scene in the object's colour bands alone."""
    assert isinstance(view, ObjectView)
    if view.linear is None:
        return rasterize(splats, view.camera)[0][0]
    origin = view.camera.positions.to(splats.means)
    return view.linear.render(colors_of(splats, view.rows[view.linear.gaussians], origin))

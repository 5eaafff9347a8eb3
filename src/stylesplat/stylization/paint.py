"""Painting objects: one or several, and the layers that come of it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.io.style_pictures import Picture, read_style
from stylesplat.progress import task
from stylesplat.rendering.visibility import LARGE, in_view, visible
from stylesplat.rendering.weights import coverage, geometry_only
from stylesplat.runtime import tidy_heap
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.layers import Composed, Layer, appearance_only, compose
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import DEFAULT_NETWORK, StyleConfig, plain_settings
from stylesplat.stylization.confine import reached_pixels
from stylesplat.stylization.features import FeatureNetwork, load_weights
from stylesplat.stylization.optimize import PaintState, paint_steps
from stylesplat.stylization.target import PaintContext, PaintTarget, check_targets, paint_context
from stylesplat.stylization.views import Box, find_boxes, per_view

LEAST_WEIGHT = 1e-6  # of an invisible Gaussian, in means
VISIBLE = 0.02  # share of some pixel: an object with less in a view is hidden, but for seams
MARGIN = 24  # pixels around what it may reach: in smaller renders Gaussians grow by as much
REPORT_EVERY = 10  # steps between two updates of the loss in the progress bar


def paint(
    splats: Splats,
    capture: Capture | Cameras,
    mask: Bool[Tensor, " N"],
    style: Picture,
    *,
    config: StyleConfig | None = None,
    network: FeatureNetwork | None = None,
) -> Splats:
    """Repaint one object in the style of a picture (StyleSplat, section 3.4, and beyond).

    Of the object's Gaussians the colours change, and what a canvas hides of them fades; no other
    Gaussian changes. The canvas's new Gaussians follow all others.

    Args:
        splats: The scene.
        capture: Views of the object; their photos are not used.
        mask: The object's Gaussians.
        style: A picture's file, or its colours: floats in 0..1, or bytes.
        config: Settings; see `StyleConfig` and `PRESETS`.
        network: The network whose features are matched; the package's own by default.

    Raises:
        StyleSplatError: If the picture is unfit, or the object is too small or not seen.
    """
    config = config or StyleConfig()
    cameras = capture.cameras if isinstance(capture, Capture) else capture
    network = network or load_weights(DEFAULT_NETWORK, depth=config.block)
    image = read_style(style, rotate=config.rotate, region=config.region)
    target = PaintTarget("object", mask, (image,), config)
    return paint_objects(paint_context(splats, cameras, network), [target]).splats


def paint_objects(context: PaintContext, targets: Sequence[PaintTarget]) -> Composed:
    """Repaint several objects one after the other, each on what is painted before."""
    check_targets(targets)
    painted = compose(context.splats, ())
    for target in targets:
        own = target.to(painted.splats)
        own = replace(own, mask=own.mask[painted.parents])
        below = replace(context, splats=painted.splats)
        layer, *_ = paint_layer(below, own, painted.parents)
        painted = compose(painted.base, (*painted.layers, layer), painted)
    return painted


def paint_layer(
    context: PaintContext, target: PaintTarget, parents: Int[Tensor, " M"]
) -> tuple[Layer, list[Box]]:
    """Paint an object on what lies below its layer.

    `parents` are the rows of the base that the Gaussians below belong to. Returns the layer, and
    the boxes of the object in all views, held-out ones included.
    """
    part, own, rows = crop_scene(context, target)
    state = None
    with task(target.name, target.config.all_steps) as bar:
        for state in paint_steps(part, own):
            bar.advance()
            if state.step % REPORT_EVERY == 0:
                bar.note(f"NNFM {state.nnfm:.3f}")
    assert state is not None  # there is at least one step
    layer = layer_of(state, own, parents[rows])
    held_out = part.all_cameras[len(part.cameras) :]
    boxes = [*state.boxes, *find_boxes(part.splats, held_out, own.mask)]
    tidy_heap()  # copies of the whole scene follow
    return layer, boxes


@torch.no_grad()
def crop_scene(
    context: PaintContext, target: PaintTarget
) -> tuple[PaintContext, PaintTarget, Int[Tensor, " M"]]:
    """Crop a large scene to the Gaussians and views that matter to an object.

    Besides the object's Gaussians these are all that would show near it if it were not there: what
    hides it, and what it hides. In views that hide the object some of these may be missing, so that
    they are left out. A small scene stays whole, and one of which no view shows the object. The
    crop's rows of the scene are returned, too.
    """
    splats, views = context.splats, [*context.all_cameras]
    everything = context, target, torch.arange(len(splats), device=splats.device)
    names = {*context.all_cameras.names}
    if len(splats) < LARGE or len(names) < len(views):
        return everything
    bare, own = geometry_only(splats), target.mask.nonzero()[:, 0]
    others = replace(bare, opacities=bare.opacities.masked_fill(target.mask, -torch.inf))
    alone, square = bare[own], np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)

    def look(view: Cameras) -> Tensor | None:
        """The Gaussians that would show near the object; None if it is hidden."""
        near = reached_pixels(alone, view)
        if not near.any():
            return None
        near = torch.from_numpy(cv2.dilate(near.cpu().numpy().astype(np.uint8), square))
        rows = visible(in_view(others, view, near.bool().to(own.device)), view).rows
        there = torch.cat([own, rows])
        is_own = torch.arange(len(there), device=there.device) < len(own)
        shares = coverage(bare[there], view, is_own)
        return rows if (shares > VISIBLE).any() else None

    kept, shown = target.mask.clone(), set[str]()
    found = per_view(look, views, "looking around the object", splats.device)
    for view, rows in zip(views, found, strict=True):
        if rows is not None:
            kept[rows] = True
            shown.update(view.names)
    if shown.isdisjoint(context.cameras.names):
        return everything
    rows = kept.nonzero()[:, 0]
    cameras, all_cameras = (
        each[[n for n, name in enumerate(each.names) if name in shown]]
        for each in (context.cameras, context.all_cameras)
    )
    part = replace(context, splats=splats[rows], cameras=cameras, all_cameras=all_cameras)
    protected = None if target.protected is None else target.protected[rows]
    return part, replace(target, mask=target.mask[rows], protected=protected), rows


def layer_of(state: PaintState, target: PaintTarget, parents: Int[Tensor, " M"]) -> Layer:
    """The layer of an object that is being painted.

    A row of the base stands for all Gaussians below that belong to it: its paint is their mean.
    """
    count, own = len(parents), target.mask.nonzero()[:, 0]
    before, after = state.base, state.splats.detach()
    opacities = torch.sigmoid(before.opacities[own])
    is_fading = after.opacities[own] != before.opacities[own]
    factors = (torch.sigmoid(after.opacities[own]) / opacities).clamp(0, 1)
    rows, members = parents[own].unique(return_inverse=True)
    mean = partial(_group_means, members=members, weights=opacities.clamp(min=LEAST_WEIGHT))
    return Layer(
        object=target.name,
        rows=rows,
        shares=torch.ones_like(rows, dtype=after.means.dtype),
        sh0=mean(after.sh0[own]),
        shN=mean(after.shN[own]),
        opacity_factors=mean(torch.where(is_fading, factors, torch.ones_like(factors))),
        surfels=appearance_only(after[count:]).map(torch.clone),  # without the rest's memory
        surfels_sh0=before.sh0[count:].clone(),
        parents=parents[state.parents[count:]],
        relief=torch.cat([mean(state.relief[own]), state.relief[count:]]),
        strength=target.config.intensity,
        form=target.config.form,
        settings=plain_settings(target.config),
    )


def _group_means(
    values: Float[Tensor, "O *_"], members: Int[Tensor, " O"], weights: Float[Tensor, " O"]
) -> Float[Tensor, "R *_"]:
    """The weighted means of groups of values; of a single value that value, to the bit."""
    count = int(members.max()) + 1
    shape = (-1, *(1,) * (values.dim() - 1))
    sums = values.new_zeros(count, *values.shape[1:])
    sums.index_add_(0, members, values * weights.view(shape))
    total = weights.new_zeros(count).index_add_(0, members, weights)
    means = sums / total.view(shape)
    single = (members.bincount(minlength=count) == 1)[members]
    return means.index_copy_(0, members[single], values[single])

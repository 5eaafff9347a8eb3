"""The optimisation of one object: its stages, its canvas, and its colours step by step."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.rendering.shares import COVERED, colors_and_coverage
from stylesplat.scene.sampling import drawn, evenly
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.stylization.colors import (
    DARKEST,
    Palette,
    add_luminance,
    blur_colors,
    build_palette,
    color_map,
    initial_colors,
    object_colors,
    project_to_palette,
    remove_pattern,
    transfer_colors,
)
from stylesplat.stylization.config import ColorMode, Stage, StyleConfig
from stylesplat.stylization.form import SURVEY_LENGTH, FormSurvey, form_relief, survey_form
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.objective import Objective, ViewTarget
from stylesplat.stylization.paintable import Paintable, confine, lay, own_gaussians
from stylesplat.stylization.style_image import (
    check_size,
    coarsen_style,
    has_features,
    style_features,
    style_parts,
)
from stylesplat.stylization.target import PaintContext, PaintTarget
from stylesplat.stylization.views import (
    Box,
    ObjectView,
    crop_to_box,
    object_views,
    require_boxes,
    stage_views,
    total_weights,
    typical_length,
    with_fixed_bands,
)
from stylesplat.training.adam import Moments, adam_step

KEPT_HUES: dict[ColorMode, float] = {"style": 0.0, "blend": 0.5, "keep": 1.0, "free": 0.0}
STYLE_FEATURES = 4096  # at random, of those of a fine stage, which has many
COLOR_VIEWS = 8  # whose pixels give an object's colours
COLOR_LENGTH = 240.0  # longer side of the object in them at most, in pixels
CANVAS_RATE = 0.5  # factor of the rate on a canvas: a pixel shows few discs, and more looks grainy
SHARPENED = 2.0  # form that is added to the colours before fine stages, of the finer band
PREVIEW_STEPS = 25  # on the object's own Gaussians: laying the canvas takes longer
PUBLISHED_VIEWS = 0.25  # share of the views that the paper uses
SHN_SLOWDOWN = 20  # ratio of the rates of sh0 and shN in the official code
FINAL_RATE = 0.1  # of the last step, as a share of the first's
TRUSTED = 0.25  # of the median weight: Gaussians that show less take smaller steps


@dataclass(frozen=True)
class PaintState:
    """An object that is being painted."""

    step: int
    """Steps taken."""
    steps: int
    """Steps to take in all."""
    nnfm: float
    """The loss in the view of the last step, before it."""
    splats: Splats
    """The scene with the paint so far, at full intensity."""
    base: Splats
    """The same Gaussians as the scene looked before."""
    parents: Int[Tensor, " N"]
    """The Gaussian of the scene before that each one belongs to."""
    relief: Float[Tensor, " N"]
    """The object's form as luminance that each Gaussian adds; see `form_relief`."""
    boxes: Sequence[Box] = ()
    """Where the object is seen, in the views to optimise on."""


@dataclass(frozen=True)
class _Goal:
    """What an object is to look like."""

    pictures: Sequence[Float[Tensor, "_ _ 3"]]
    """The style images, in the hues that the object is to have."""
    colors: Float[Tensor, "P 3"]
    """All of their colours."""
    palette: Palette | None
    """The colours to stay near to; None leaves them free."""


def paint_steps(
    context: PaintContext, target: PaintTarget, *, preview: bool = False
) -> Iterator[PaintState]:
    """Paint one object of a scene.

    Args:
        context: The scene and its views.
        target: The object and its style.
        preview: Show first strokes on the object's own Gaussians before the canvas is laid. These
            steps come in addition, and change nothing in the result.

    Yields:
        The state after every step. Whoever stops asking keeps what there is; whoever asks again
        goes on.

    Raises:
        StyleSplatError: If the object is not seen, nothing is its own, or a style image is too
            small.
    """
    config, object = target.config, own_gaussians(context, target)
    survey = require_boxes(object.context, object.target, context.cameras)
    boxes = _used_boxes(survey, config)
    stages, canvas_at = _stages(context, target, typical_length(boxes)), 0
    if preview and config.max_discs(1) > 0:
        stages, canvas_at = [replace(stages[0], steps=PREVIEW_STEPS), *stages], 1
    confined_at = next((n for n, each in enumerate(stages) if each.fine), len(stages) - 1)
    steps, done = sum(stage.steps for stage in stages), 0
    generator = torch.Generator().manual_seed(config.seed)
    views, goal, paint = list[ObjectView](), None, object.splats
    form, relief = _survey_form(object, boxes), object.splats.means.new_zeros(0, 2)
    color_views, color_length = list[ObjectView](), 0.0
    for number, stage in enumerate(stages):
        views.clear()  # before there are others: they take much memory
        anew = number in (0, canvas_at)
        if number == canvas_at:
            object = lay(object, boxes, stages[-1].length)
        if number == confined_at and object.canvas is not None:
            object, kept = confine(object, boxes, None if anew else paint)
            if not anew:
                paint = replace(object.splats, sh0=paint.sh0[kept], shN=paint.shN[kept])
        views += stage_views(object.context, object.target, boxes, stage, generator)
        if stage.window is None and len(views) >= COLOR_VIEWS:
            color_views, color_length = evenly(views, COLOR_VIEWS), stage.length
        elif number <= confined_at:  # later stages have the same Gaussians
            color_length = min(stage.length, COLOR_LENGTH)
            color_views = _color_views(object, boxes, color_length)
        if anew or number == confined_at:
            rest = color_views, color_length, form
            relief = form_relief(object.before, object.splats, object.mask, *rest)
        if anew or goal is None:
            goal, paint = _begin(object, color_views, color_length, relief)
        elif number == confined_at:  # coarse stages lose what is finer than their pixels
            paint = add_luminance(paint, _form_weight(config, SHARPENED) * relief[:, 0])
        objective = replace(_objective(object, goal, stage), form=form)
        targets = objective.targets(views, object.before, paint if stage.fine else None)
        taken = optimize_colors(paint, object.mask, targets, objective, stage.steps)
        for number_in_stage, (paint, nnfm) in enumerate(taken, start=1):
            done += 1
            if number_in_stage == stage.steps:
                last = number == len(stages) - 1
                if not (stage.fine or last or goal.palette is None):
                    paint = blur_colors(paint, object.mask, color_views)
                paint = _end_stage(object, goal, paint, color_views, last)
            yield PaintState(
                step=done,
                steps=steps,
                nnfm=nnfm,
                splats=paint,
                base=object.unpainted,
                parents=object.parents,
                relief=relief.sum(dim=1),
                boxes=survey,
            )


def check_visible(context: PaintContext, target: PaintTarget) -> None:
    """Check that an object can be painted, in less time than painting it takes.

    Raises:
        StyleSplatError: As `paint_steps` does.
    """
    object = own_gaussians(context, target)
    boxes = require_boxes(object.context, object.target, context.cameras)
    boxes = _used_boxes(boxes, target.config)
    length = typical_length(boxes)
    first, *_ = _stages(context, target, length)
    object_views(object.context, object.target, boxes, first.length / length)


def optimize_colors(
    paint: Splats,
    mask: Bool[Tensor, " N"],
    targets: Sequence[ViewTarget],
    objective: Objective,
    steps: int,
) -> Iterator[tuple[Splats, float]]:
    """Move the colours of some Gaussians until the object's features match the style's.

    Args:
        paint: The scene, without gradients, with the colours to start from.
        mask: The Gaussians to paint.
        targets: Views of the object; one is drawn per step.
        objective: What to minimise; its settings are the rates and the seed.
        steps: How many to take.

    Yields:
        The scene after every step, and the style loss before it.
    """
    config = objective.config
    generator = torch.Generator().manual_seed(config.seed)
    rows = mask.nonzero()[:, 0]
    leaves = {"sh0": paint.sh0[rows].requires_grad_()}
    rates = {"sh0": config.lr, "shN": config.lr / SHN_SLOWDOWN}
    trust = None
    if config.published:
        leaves["shN"] = paint.shN[rows].requires_grad_()
    else:
        views = with_fixed_bands([target.view for target in targets], paint)
        pairs = zip(targets, views, strict=True)
        targets = [replace(target, view=view) for target, view in pairs]
        weights = total_weights(views, paint, mask)
        typical = weights[weights > 0].median()
        trust = (weights / (weights + TRUSTED * typical))[:, None, None]
    moments = Moments.zeros(leaves)
    for number, target in enumerate(drawn(targets, steps, generator), start=1):
        with torch.enable_grad():  # the caller may have disabled it
            losses = objective(target, paint.with_rows(rows, leaves))
            losses.total.backward()
        before = leaves["sh0"].detach().clone()
        decay = 1.0 if config.published else FINAL_RATE ** ((number - 1) / steps)
        adam_step(leaves, moments, {name: decay * rates[name] for name in leaves}, number)
        with torch.no_grad():
            if trust is not None:  # Adam's steps are as long for Gaussians that hardly show
                sh0 = leaves["sh0"]
                sh0.copy_(torch.lerp(before, sh0, trust))
                _clamp_to_range(sh0)
            for leaf in leaves.values():
                leaf.grad = None
        yield paint.with_rows(rows, leaves).detach(), losses.style.item()


def target_features(
    context: PaintContext, config: StyleConfig, pictures: Sequence[Tensor], length: float
) -> list[Tensor]:
    """The features of all style images together, for each layer group.

    Args:
        context: Its network is used.
        config: The scale and the layer groups.
        pictures: Colours in 0..1.
        length: The object's longer side in pixels, which the pictures follow.
    """
    size = config.scale * length
    generator = torch.Generator().manual_seed(config.seed)
    features = [
        style_features(part, context.network, config.layers, length=size * share)
        for picture in pictures
        for part, share in style_parts(picture, size, generator)
    ]
    return [torch.cat(group) for group in zip(*features, strict=True)]


def _used_boxes(boxes: Sequence[Box], config: StyleConfig) -> Sequence[Box]:
    """Boxes of the views to optimise on."""
    if not config.published:
        return boxes
    return evenly(boxes, math.ceil(PUBLISHED_VIEWS * len(boxes)))


def _stages(context: PaintContext, target: PaintTarget, photo_length: float) -> list[Stage]:
    """The stages; all steps at the last size if a style image is too small before.

    Raises:
        StyleSplatError: If a style image is too small for that, too.
    """
    config = target.config
    *_, last = stages = config.stages(photo_length)
    network = context.network, config.layers
    for picture in target.styles:
        check_size(picture, *network, length=config.scale * last.length)
        if not all(has_features(picture, *network, length=config.scale * s.length) for s in stages):
            return [replace(last, steps=config.all_steps)]
    return stages


def _color_views(object: Paintable, boxes: Sequence[Box], length: float) -> list[ObjectView]:
    """A few views of the whole object, which is as long in them, for its colours."""
    few, zoom = evenly(boxes, COLOR_VIEWS), length / typical_length(boxes)
    return object_views(object.context, object.target, few, zoom, max_memory=math.inf)


def _survey_form(object: Paintable, boxes: Sequence[Box]) -> FormSurvey:
    """The object's detail, whatever size it is painted in."""
    splats, zoom = object.before, SURVEY_LENGTH / typical_length(boxes)
    cameras = [crop_to_box(box, zoom, (0, 0))[0] for box in evenly(boxes, COLOR_VIEWS)]
    pairs = [colors_and_coverage(splats, camera, object.mask) for camera in cameras]
    images, covered = zip(*pairs, strict=True)
    return survey_form(images, [each[..., 0] > COVERED for each in covered], SURVEY_LENGTH)


def _begin(
    object: Paintable, views: Sequence[ObjectView], length: float, relief: Float[Tensor, "N 2"]
) -> tuple[_Goal, Splats]:
    """What the object is to look like, and the colours to start from.

    Args:
        object: What is painted.
        views: Of the object.
        length: Its longer side in them, in pixels.
        relief: Its form.
    """
    config, splats, mask = object.target.config, object.splats, object.mask
    pictures = _pictures(object, views)
    colors = torch.cat([picture.reshape(-1, 3) for picture in pictures])
    if config.published:
        return _Goal(pictures, colors, None), splats
    splats = remove_pattern(splats, mask, views, length, config.pattern_removed)
    splats = add_luminance(splats, _form_weight(config) * relief.sum(dim=1))
    palette = None
    if config.color != "free":
        palette = build_palette(colors)
        splats = initial_colors(splats, mask, views, colors, seed=config.seed)
    matte = splats.shN.masked_fill(mask[:, None, None], 0)
    return _Goal(pictures, colors, palette), replace(splats, shN=matte)


def _form_weight(config: StyleConfig, factor: float = 1.0) -> float:
    """The form to add to colours: what was removed of it with the pattern, times a factor."""
    return factor * config.form * config.pattern_removed


def _pictures(object: Paintable, views: Sequence[ObjectView]) -> list[Tensor]:
    """The style images, in the object's hues as far as these are to be kept."""
    config, styles = object.target.config, list(object.target.styles)
    if config.color != "free":
        styles = [coarsen_style(style, config.scale) for style in styles]
    share = KEPT_HUES[config.color]
    if share == 0:
        return styles
    own = object_colors(object.splats, views)
    matrix, offset = color_map(torch.cat([s.reshape(-1, 3) for s in styles]), own)
    return [s.lerp((s @ matrix.T + offset).clamp(0, 1), share) for s in styles]


def _objective(object: Paintable, goal: _Goal, stage: Stage) -> Objective:
    context, config = object.context, object.target.config
    features = target_features(context, config, goal.pictures, stage.length)
    if stage.fine:
        generator = torch.Generator().manual_seed(config.seed)
        rows = (torch.randperm(len(group), generator=generator) for group in features)
        pairs = zip(features, rows, strict=True)
        features = [group[some[:STYLE_FEATURES].to(group.device)] for group, some in pairs]
    rate = stage.rate * (1.0 if object.canvas is None else CANVAS_RATE)
    return Objective(
        network=context.network.to(context.splats.device, context.precision),
        styles=[build_index(group, context.precision) for group in features],
        config=replace(config, lr=rate * config.lr),
        length=stage.length,
        palette=goal.palette,
    )


def _end_stage(
    object: Paintable, goal: _Goal, paint: Splats, views: Sequence[ObjectView], last: bool
) -> Splats:
    """The paint after a stage, in the style's colours."""
    if goal.palette is None:
        return paint
    paint = transfer_colors(paint, object.mask, goal.colors, views)
    return project_to_palette(paint, object.mask, views, goal.palette) if last else paint


@torch.no_grad()
def _clamp_to_range(sh0: Tensor) -> None:
    """Colours that the rasteriser clamps at 0 would have no gradient to come back by."""
    black, white = sh0_from_rgb(torch.tensor([[DARKEST], [1.0]]).expand(2, 3)).to(sh0)
    sh0.clamp_(black, white)

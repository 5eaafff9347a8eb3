"""The optimisation of one object: its stages, its canvas, and its colours step by step."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import Palette, build_palette, color_map, mapped
from stylesplat.progress import say
from stylesplat.rendering.weights import COVERED, colors_and_coverage
from stylesplat.scene.sequences import drawn, evenly
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.selection.shares import own_shares
from stylesplat.stylization.canvas import Canvas, fit_canvas, lay_canvas
from stylesplat.stylization.colors import (
    DARKEST,
    add_luminance,
    blur_colors,
    object_colors,
    project_to_palette,
    remove_pattern,
    transfer_colors,
    vary_colors,
)
from stylesplat.stylization.config import ColorMode, Stage, StyleConfig
from stylesplat.stylization.confine import confine_canvas
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.form import SURVEY_LENGTH, FormSurvey, form_relief, survey_form
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.objective import Objective, ViewTarget
from stylesplat.stylization.style import (
    all_colors,
    coarsen_style,
    style_features,
    style_parts,
    without_strokes,
)
from stylesplat.stylization.target import PaintContext, PaintTarget
from stylesplat.stylization.views import (
    Box,
    ObjectView,
    box_cameras,
    object_views,
    require_boxes,
    stage_views,
    total_weights,
    typical_length,
)
from stylesplat.training.adam import Moments, adam_step

OWN = 0.5  # share of a Gaussian that is the object's: one with less is not painted
KEPT_HUES: dict[ColorMode, float] = {"blend": 0.5, "keep": 1.0}
STYLE_FEATURES = 2048  # at random, of those of a fine stage; 4,096 look the same, and take longer
COLOR_VIEWS = 8  # whose pixels give an object's colours; with 6 rare sides get too much form
BLUR_VIEWS = 6  # that suffice between stages
COLOR_LENGTH = 240.0  # longer side of the object in them at most, in pixels
CANVAS_RATE = 0.5  # factor of the rate on a canvas: a pixel shows few discs, and more looks grainy
SHARPENED = 2.0  # form of the finer band, added to the colours once: see `_paint`
PREVIEW_STEPS = 25  # on the object's own Gaussians: laying the canvas takes longer
PUBLISHED_VIEWS = 0.25  # share of the views that the paper uses
SHN_SLOWDOWN = 20  # ratio of the rates of sh0 and shN in the official code
FINAL_RATE = 0.1  # of the last step, as a share of the first's
TRUSTED = 0.25  # of the median weight: Gaussians that show less take smaller steps


@dataclass(frozen=True, eq=False)
class PaintState:
    """An object that is being painted."""

    step: int
    """Steps taken."""
    steps: int
    """Steps to take in all."""
    nnfm: Float[Tensor, ""]
    """The loss in the view of the last step, before it; reading it waits for the device."""
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


@dataclass(frozen=True, eq=False)
class _Object:
    """An object with the canvas that it is painted on."""

    context: PaintContext
    """Its scene is that of the canvas."""
    target: PaintTarget
    """Its mask has the Gaussians that are painted."""
    canvas: Canvas
    survey: Sequence[Box]
    """Where it is seen, in the views to optimise on."""
    boxes: Sequence[Box]
    """Those that are used: the paper uses few."""
    form: FormSurvey

    def on(self, canvas: Canvas) -> "_Object":
        context = replace(self.context, splats=canvas.splats)
        target = replace(self.target, mask=canvas.mask)
        return replace(self, context=context, target=target, canvas=canvas)

    def stage_views(self, stage: Stage, generator: torch.Generator) -> list[ObjectView]:
        surface = self.canvas.surface
        return stage_views(self.context, self.target, self.boxes, stage, generator, surface)

    def views(self, length: float) -> tuple[list[ObjectView], float]:
        """A few views of the whole object, which is as long in them."""
        few, zoom = evenly(self.boxes, COLOR_VIEWS), length / typical_length(self.boxes)
        views = object_views(self.context, self.target, few, zoom, max_memory=math.inf)
        return views, length


def paint_steps(
    context: PaintContext, target: PaintTarget, *, preview: bool = False
) -> Iterator[PaintState]:
    """Paint one object of a scene.

    Args:
        context: The scene and its views.
        target: The object and its style.
        preview: Show first strokes on the object's own Gaussians before the canvas is laid. These
            steps come in addition, and change nothing in the result.

    Returns:
        The state after every step. Whoever stops asking keeps what there is; whoever asks again
        goes on.

    Raises:
        StyleSplatError: If the object is not seen, or nothing is its own.
    """
    target, survey, boxes = _survey(context, target)
    canvas = Canvas.without_discs(context.splats, target.mask)
    form = survey_detail(context.splats, target.mask, boxes)
    object = _Object(context, target, canvas, survey, boxes, form)
    stages, previews = target.config.stages(typical_length(boxes)), list[Stage]()
    if preview and target.config.max_discs(1) > 0:
        previews.append(replace(stages[0], steps=min(PREVIEW_STEPS, stages[0].steps)))
    done = sum(stage.steps for stage in previews)
    steps = done + sum(stage.steps for stage in stages)
    painting = _paint(object, stages, done=done, steps=steps)
    return chain(_paint(object, previews, steps=steps, is_preview=True), painting)


def check_visible(context: PaintContext, target: PaintTarget) -> None:
    """Raise the errors of `paint_steps`, in less time than painting takes."""
    target, _, boxes = _survey(context, target)
    length = typical_length(boxes)
    object_views(context, target, boxes, target.config.stages(length)[0].length / length)


def _survey(
    context: PaintContext, target: PaintTarget
) -> tuple[PaintTarget, list[Box], Sequence[Box]]:
    """The target without what lies mostly beside it, where it is seen, and the boxes to use."""
    if target.config.published:
        survey = require_boxes(context, target)
        return target, survey, evenly(survey, math.ceil(PUBLISHED_VIEWS * len(survey)))
    own = own_shares(context.splats, target.mask, context.cameras) > OWN
    if not own.any():
        require_boxes(context, target)  # else that is why
        raise StyleSplatError(
            f"Cannot stylise {target.name}: most of what each of its Gaussians paints lies "
            "where they cover less than half. Pick more of the object."
        )
    target = replace(target, mask=own)
    survey = require_boxes(context, target)
    return target, survey, survey


def survey_detail(splats: Splats, mask: Bool[Tensor, " N"], boxes: Sequence[Box]) -> FormSurvey:
    """The detail of an object, whatever size it is painted in."""
    cameras = box_cameras(boxes, SURVEY_LENGTH, COLOR_VIEWS, margin=0)
    pairs = [colors_and_coverage(splats, camera, mask) for camera in cameras]
    images, covered = zip(*pairs, strict=True)
    return survey_form(images, [each[..., 0] > COVERED for each in covered], SURVEY_LENGTH)


def _paint(
    object: _Object, stages: Sequence[Stage], *, done: int = 0, steps: int, is_preview: bool = False
) -> Iterator[PaintState]:
    """Paint an object in stages: on a canvas, or for a preview on its own Gaussians."""
    config = object.target.config
    if not is_preview:
        object = _lay(object, stages[-1].length)
    fixed_at = next((n for n, each in enumerate(stages) if each.fine), len(stages) - 1)
    generator = torch.Generator().manual_seed(config.seed)
    paint, relief = object.canvas.splats, torch.zeros(0, 2)
    pictures, palette = list[Tensor](), None
    whole = list[ObjectView](), 0.0  # views of the whole object, and its length in them
    for number, stage in enumerate(stages):
        is_last = number == len(stages) - 1 and not is_preview
        if number == fixed_at and object.canvas.is_disc.any():
            object, paint = _confine(object, paint, turned=number > 0)
        mask = object.target.mask
        views = object.stage_views(stage, generator)
        if stage.window is None and len(views) >= (COLOR_VIEWS if number == 0 else BLUR_VIEWS):
            whole = evenly(views, COLOR_VIEWS), stage.length
        elif number <= fixed_at:  # later stages have the same Gaussians
            whole = object.views(min(stage.length, COLOR_LENGTH))
        if number in (0, fixed_at):
            before, splats = object.canvas.before, object.canvas.splats
            relief = form_relief(before, splats, mask, *whole, object.form)
        if number == 0:
            pictures, palette, paint = _begin(object, *whole, relief)
        elif number == fixed_at:  # before fine stages, or a draft's last: coarser ones lose it
            weight = SHARPENED * config.form * config.pattern_removed
            paint = add_luminance(paint, weight * relief[:, 0])
        objective = stage_objective(
            object.context,
            config,
            pictures,
            stage,
            object.form,
            palette,
            is_fine_surface=bool(object.canvas.is_disc.any()),
        )
        targets = objective.targets(views, object.canvas.before, paint if stage.fine else None)
        taken = optimize_colors(paint, mask, targets, objective, stage.steps)
        for step, (paint, nnfm) in enumerate(taken, start=1):
            if step == stage.steps and palette is not None:
                goal = pictures
                if not (stage.fine or is_last):
                    paint = blur_colors(paint, mask, whole[0])
                    goal = without_strokes(pictures, config.scale)
                paint = transfer_colors(paint, mask, all_colors(goal), whole[0])
                if is_last:
                    is_disc = object.canvas.is_disc
                    beneath = mask & ~is_disc & is_disc.any()
                    paint = project_to_palette(paint, mask, whole[0], palette, beneath)
            done += 1
            yield PaintState(
                step=done,
                steps=steps,
                nnfm=nnfm,
                splats=paint,
                base=object.canvas.unpainted,
                parents=object.canvas.parents,
                relief=relief.sum(dim=1),
                boxes=object.survey,
            )
        del views, targets  # they take much memory: others are made next


def _lay(object: _Object, length: float) -> _Object:
    """Lay a canvas that is fine enough for this length, if the object has a surface for it."""
    config = object.target.config
    max_discs = config.max_discs(int(object.target.mask.sum()))
    if max_discs == 0 or config.intensity == 0:
        return object
    canvas = lay_canvas(
        object.canvas.splats,
        object.canvas.mask,
        object.boxes,
        length=length,
        max_discs=max_discs,
        seed=config.seed,
    )
    if canvas is None:
        say(f"{object.target.name} has no surface for a canvas: its own Gaussians are painted.")
        return object
    return object.on(fit_canvas(canvas, seed=config.seed))


def _confine(object: _Object, paint: Splats, *, turned: bool) -> tuple[_Object, Splats]:
    """Let no disc show beside the object, and turn them along the strokes if there are any."""
    canvas, kept = confine_canvas(
        object.canvas,
        object.context.all_cameras,
        painted=paint if turned else None,
        protected=object.target.protected,
    )
    canvas = replace(canvas, views=())  # they are not needed again, and take memory
    return object.on(canvas), replace(canvas.splats, sh0=paint.sh0[kept], shN=paint.shN[kept])


def _begin(
    object: _Object, views: Sequence[ObjectView], length: float, relief: Float[Tensor, "N 2"]
) -> tuple[list[Tensor], Palette | None, Splats]:
    """The style images, the palette to stay near to if colours are not free, and the first paint.

    The views show all of the object, so many pixels long.
    """
    config, splats, mask = object.target.config, object.canvas.splats, object.target.mask
    share, palette = KEPT_HUES.get(config.color, 0.0), None
    if not config.published:
        splats = replace(splats, shN=splats.shN.masked_fill(mask[:, None, None], 0))
    own = object_colors(splats, views) if share > 0 else None
    pictures = style_pictures(object.target.styles, config, own, share)
    if config.published:
        return pictures, palette, splats
    splats = remove_pattern(splats, mask, views, length, config.pattern_removed)
    form = config.form * config.pattern_removed  # what was removed of it with the pattern
    splats = add_luminance(splats, form * relief.sum(dim=1))
    if config.color != "free":
        palette = build_palette(all_colors(pictures))
        colors = all_colors(without_strokes(pictures, config.scale))
        splats = transfer_colors(vary_colors(splats, mask, seed=config.seed), mask, colors, views)
    return pictures, palette, splats


def style_pictures(
    styles: Sequence[Tensor],
    config: StyleConfig,
    own: Float[Tensor, "P 3"] | None,
    share: float = 1.0,
) -> list[Tensor]:
    """Style images for strokes of this size, with a share of the object's own hues if known."""
    if config.color != "free":
        styles = [coarsen_style(style, config.scale) for style in styles]
    if own is None:
        return [*styles]
    to_own = color_map(all_colors(styles), own)
    return [style.lerp(mapped(style, to_own).clamp(0, 1), share) for style in styles]


def stage_objective(
    context: PaintContext,
    config: StyleConfig,
    pictures: Sequence[Tensor],
    stage: Stage,
    form: FormSurvey,
    palette: Palette | None,
    *,
    is_fine_surface: bool,
) -> Objective:
    """The objective of a stage; a canvas or a texture takes smaller steps."""
    network = context.network.to(context.splats.device, context.precision)
    features = target_features(network, config, pictures, stage.length)
    if stage.fine:
        generator = torch.Generator().manual_seed(config.seed)
        features = features[torch.randperm(len(features), generator=generator)[:STYLE_FEATURES]]
    rate = stage.rate * (CANVAS_RATE if is_fine_surface else 1.0)
    return Objective(
        network=network,
        style=build_index(features, context.precision, balanced=not config.published),
        config=replace(config, lr=rate * config.lr),
        length=stage.length,
        form=form,
        palette=palette,
    )


def optimize_colors(
    paint: Splats,
    mask: Bool[Tensor, " N"],
    targets: Sequence[ViewTarget],
    objective: Objective,
    steps: int,
) -> Iterator[tuple[Splats, Float[Tensor, ""]]]:
    """Move the colours of some Gaussians until the object's features match the style's.

    Each step draws one of the targets. Yields the scene after every step, and the NNFM before it.
    """
    config = objective.config
    generator = torch.Generator().manual_seed(config.seed)
    rows = mask.nonzero()[:, 0]
    leaves = {"sh0": paint.sh0[rows].requires_grad_()}
    rates = {"sh0": config.lr, "shN": config.lr / SHN_SLOWDOWN}
    # colours that the rasteriser clamps at 0 would have no gradient to come back by
    limits = sh0_from_rgb(torch.tensor([[DARKEST], [1.0]]).expand(2, 3)).to(paint.sh0)
    trust = None
    if config.published:
        leaves["shN"] = paint.shN[rows].requires_grad_()
    else:
        weights = total_weights([target.view for target in targets], paint, mask)
        trust = (weights / (weights + TRUSTED * weights[weights > 0].median()))[:, None, None]
    moments, potentials = Moments.zeros(leaves), None
    for number, target in enumerate(drawn(targets, steps, generator), start=1):
        with torch.enable_grad():  # the caller may have disabled it
            painted = paint.with_rows(rows, leaves)
            nnfm, total, potentials = objective(target, painted, potentials)
            total.backward()
        before = leaves["sh0"].detach().clone()
        decay = 1.0 if config.published else FINAL_RATE ** ((number - 1) / steps)
        adam_step(leaves, moments, {name: decay * rates[name] for name in leaves}, number)
        with torch.no_grad():
            if trust is not None:  # Adam's steps are as long for Gaussians that hardly show
                leaves["sh0"].copy_(before.lerp(leaves["sh0"], trust).clamp(*limits))
            for leaf in leaves.values():
                leaf.grad = None
        yield paint.with_rows(rows, leaves).detach(), nnfm.detach()


def target_features(
    network: FeatureNetwork, config: StyleConfig, pictures: Sequence[Tensor], length: float
) -> Float[Tensor, "Q D"]:
    """The features of all style images together, beside an object so long."""
    size = config.scale * length
    generator = torch.Generator().manual_seed(config.seed)
    features = [
        style_features(part, network, config.block, length=size * share)
        for picture in pictures
        for part, share in style_parts(picture, size, generator)
    ]
    return torch.cat(features)

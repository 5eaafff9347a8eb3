"""Repainting one object, step by step: coarse, then on finer Gaussians."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import (
    color_map,
    initial_colors,
    mixed_colors,
    object_colors,
    transfer_colors,
)
from stylesplat.stylization.form import form_relief
from stylesplat.stylization.levelled import levelled
from stylesplat.stylization.looking import check_visible, object_views, see_object, stage_views
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.near_palette import NearPalette, near_palette, settle
from stylesplat.stylization.object_views import Box, ObjectView, typical_length
from stylesplat.stylization.objective import Objective
from stylesplat.stylization.optimize import optimize_colors
from stylesplat.stylization.paint_ground import Ground, canvas_ground, confined_ground, own_ground
from stylesplat.stylization.stages import Stage
from stylesplat.stylization.style_config import ColorMode, StyleConfig
from stylesplat.stylization.style_job import Studio, StyleJob
from stylesplat.stylization.target import check_size, fits, style_features
from stylesplat.stylization.texture import soften

KEPT: dict[ColorMode, float] = {"style": 0.0, "blend": 0.5, "keep": 1.0, "free": 0.0}
STYLE_FEATURES = 4096  # at random, of fine ones, of which there are many
COLOR_VIEWS = 8  # whose pixels tell an object's colours
CALM = 0.5  # factor of the rate on a fresh canvas: a pixel shows few discs, and more looks grainy
CANVAS_AT = 1  # the stage before which it is laid: the first strokes are seen at once


@dataclass(frozen=True)
class Repainted:
    """An object on its way from a scene to its style."""

    step: int
    """Steps taken."""
    steps: int
    """Steps to take in all."""
    nnfm: float
    """The loss in the view of the last step, before it; before the first step it is nan."""
    splats: Splats
    """The scene with the object's colours so far, at full intensity."""
    base: Splats
    """The same Gaussians as they looked before."""
    parents: Int[Tensor, " N"]
    """Which Gaussian of the scene before each one comes from."""
    relief: Float[Tensor, " N"]
    """The object's form as luminance that each Gaussian adds; see `form_relief`."""


@dataclass(frozen=True)
class Aim:
    """What an object is to look like."""

    views: Sequence[ObjectView]
    """A few, which tell its colours."""
    pictures: Sequence[Float[Tensor, "_ _ 3"]]
    """The style images, in the hues that the object is to have."""
    palette: Float[Tensor, "P 3"]
    """All of their colours."""
    near: NearPalette | None
    """The colours to stay near to; None leaves them free."""


@dataclass(frozen=True)
class Sight:
    """What is known of an object before it is painted."""

    ground: Ground
    """What it is painted on at first."""
    survey: Sequence[Box]
    """Its boxes in all views to optimise on."""
    boxes: Sequence[Box]
    """Those of the views that are used."""
    stages: Sequence[Stage]
    """How it is painted."""


def repaint(studio: Studio, job: StyleJob, sight: Sight | None = None) -> Iterator[Repainted]:
    """Repaint one object of a scene.

    Args:
        studio: The scene.
        job: The object.
        sight: What is known of it, if it was looked at before.

    Yields:
        The state after every step. Whoever stops asking keeps what there is; whoever asks again
        goes on.

    Raises:
        StyleSplatError: If the object is not seen, nothing is its own, or a style image is too
            small.
    """
    config = job.config
    sight = sight or look_at(studio, job)
    ground, boxes, stages = sight.ground, sight.boxes, sight.stages
    canvas_at = min(CANVAS_AT, len(stages) - 1)
    confined_at = next((n for n, each in enumerate(stages) if each.anchored), len(stages) - 1)
    confined_at = max(confined_at, canvas_at)
    generator = torch.Generator().manual_seed(config.seed)
    views, aim, current, done = list[ObjectView](), None, None, 0
    relief = torch.zeros(0)
    for number, stage in enumerate(stages):
        views.clear()  # before there are others: they take much memory
        begun = number == 0
        if number == canvas_at:
            ground = canvas_ground(ground, boxes, config.finest(typical_length(boxes)))
            begun |= ground.canvas is not None
        if number == confined_at and ground.canvas is not None:
            ground, kept = confined_ground(ground, boxes, None if begun else current)
            if current is not None and not begun:
                current, relief = _colored(ground, current, kept), relief[kept]
        views += stage_views(ground.studio, ground.job, boxes, stage, generator)
        few = _few_views(ground, boxes, stage, views)
        if begun or aim is None or current is None:
            aim, current = _begun(ground, few)
            relief = form_relief(ground.studio.splats, ground.job.picked, few, stage.lengths[0])
        aim = replace(aim, views=few)
        objective = _objective(ground, aim, stage)
        targets = objective.targets(
            views, ground.studio.splats, _mixed(ground, current) if stage.anchored else None
        )
        for step in optimize_colors(
            current, ground.studio.splats, ground.shares, targets, objective, stage.steps
        ):
            done, current, shown = done + 1, step.paint, step.splats
            if step.number == stage.steps:
                current, shown = _ended(ground, aim, current, last=done == config.all_steps)
            yield Repainted(
                step=done,
                steps=config.all_steps,
                nnfm=step.nnfm,
                splats=shown,
                base=ground.unpainted,
                parents=ground.parents,
                relief=relief,
            )


def _colored(ground: Ground, paint: Splats, kept: Bool[Tensor, " N"]) -> Splats:
    """The ground's Gaussians in the colours of a paint of which some are left."""
    return replace(ground.studio.splats, sh0=paint.sh0[kept], shN=paint.shN[kept])


def _mixed(ground: Ground, paint: Splats) -> Splats:
    """The ground with each Gaussian's share of a paint."""
    return mixed_colors(ground.studio.splats, paint, ground.shares)


def look_at(studio: Studio, job: StyleJob, *, closely: bool = False) -> Sight:
    """Look at an object before it is painted.

    Args:
        studio: The scene.
        job: The object.
        closely: Whether it is to be seen at the size of the first stage, too.

    Raises:
        StyleSplatError: As `repaint` does, as far as it can be told so.
    """
    ground = own_ground(studio, job)
    survey = see_object(studio, ground.job, studio.cameras)
    boxes = evenly(survey, math.ceil(job.config.view_share * len(survey)))
    stages = _stages(studio, job, typical_length(boxes))
    if closely:
        generator = torch.Generator().manual_seed(job.config.seed)
        check_visible(studio, ground.job, boxes, stages[0], generator)
    return Sight(ground, survey, boxes, stages)


def _begun(ground: Ground, views: Sequence[ObjectView]) -> tuple[Aim, Splats]:
    """What the object is to look like, and the colours to start from."""
    aim, job, splats = _aim(ground, views), ground.job, ground.studio.splats
    splats = soften(splats, job.picked, views, job.config.softened)
    return aim, initial_colors(splats, job.picked, views, aim.palette, job.config)


def _few_views(
    ground: Ground, boxes: Sequence[Box], stage: Stage, views: Sequence[ObjectView]
) -> list[ObjectView]:
    """Views that tell the object's colours: the stage's own, if they show all of it."""
    if stage.window is None and len(views) >= COLOR_VIEWS:
        return evenly(views, COLOR_VIEWS)
    few, zoom = evenly(boxes, COLOR_VIEWS), stage.lengths[0] / typical_length(boxes)
    return object_views(ground.studio, ground.job, few, zoom, max_memory=math.inf)


def _aim(ground: Ground, views: Sequence[ObjectView]) -> Aim:
    pictures = _pictures(ground, views)
    palette = torch.cat([picture.reshape(-1, 3) for picture in pictures])
    near = None if ground.job.config.color == "free" else near_palette(palette)
    return Aim(views, pictures, palette, near)


def _ended(ground: Ground, aim: Aim, paint: Splats, *, last: bool) -> tuple[Splats, Splats]:
    """The paint and what shows of it, in the colours of the style, after a stage."""
    shares, config = ground.shares, ground.job.config
    paint = levelled(paint, ground.job.picked, aim.views, config.levelled)
    if aim.near is None:
        return paint, _mixed(ground, paint)
    paint = transfer_colors(paint, ground.job.picked, aim.palette, aim.views)
    shown = _mixed(ground, paint)
    return paint, settle(shown, shares, aim.views, aim.near) if last else shown


def target_features(
    studio: Studio, config: StyleConfig, pictures: Sequence[Tensor], length: float
) -> list[Tensor]:
    """The features of all style images together, for each layer group.

    Args:
        studio: Whose network to use.
        config: The scale and the layer groups.
        pictures: Colours in 0..1.
        length: Longer side of the object in pixels, which the pictures follow.
    """
    size = config.scale * length
    features = [
        style_features(picture, studio.network, config.layers, length=size) for picture in pictures
    ]
    return [torch.cat(group) for group in zip(*features, strict=True)]


def _stages(studio: Studio, job: StyleJob, photo_length: float) -> list[Stage]:
    """Sizes of the object and steps; all at the last size if a style is too small before.

    Raises:
        StyleSplatError: If a style image is too small for that, too.
    """
    config = job.config
    *_, last = stages = config.stages(photo_length)
    styles = (studio.network, config.layers)
    for picture in job.styles:
        check_size(picture, *styles, length=config.scale * last.lengths[0])
        if not all(fits(picture, *styles, length=config.scale * s.lengths[0]) for s in stages):
            return [replace(last, steps=config.all_steps)]
    return stages


def _pictures(ground: Ground, views: Sequence[ObjectView]) -> list[Tensor]:
    """The style images, in the object's colours as far as these are to be kept."""
    job = ground.job
    share = KEPT[job.config.color]
    if share == 0:
        return list(job.styles)
    own = object_colors(ground.studio.splats, views)
    matrix, offset = color_map(torch.cat([s.reshape(-1, 3) for s in job.styles]), own)
    return [s.lerp((s @ matrix.T + offset).clamp(0, 1), share) for s in job.styles]


def _objective(ground: Ground, aim: Aim, stage: Stage) -> Objective:
    studio, config = ground.studio, ground.job.config
    features = target_features(studio, config, aim.pictures, stage.lengths[0])
    if stage.anchored:
        generator = torch.Generator().manual_seed(config.seed)
        features = [_some(group, generator) for group in features]
    calm = CALM if ground.canvas is not None else 1.0
    return Objective(
        network=studio.network.to(studio.splats.device, studio.precision),
        styles=[build_index(group, studio.precision) for group in features],
        config=replace(config, lr=stage.rate * calm * config.lr),
        length=stage.lengths[0],
        near=aim.near,
    )


def _some(group: Tensor, generator: torch.Generator) -> Tensor:
    few = torch.randperm(len(group), generator=generator)[:STYLE_FEATURES]
    return group[few.to(group.device)]

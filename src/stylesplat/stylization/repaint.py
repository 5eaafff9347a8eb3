"""Repainting one object, step by step: split what is too large, then paint coarse and fine."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import color_map, object_colors, transfer_colors, vary_colors
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.object_views import (
    Box,
    ObjectView,
    cut_views,
    find_boxes,
    typical_length,
    windows,
)
from stylesplat.stylization.objective import Objective
from stylesplat.stylization.optimize import optimize_colors
from stylesplat.stylization.split import Split, split_large
from stylesplat.stylization.stages import Stage
from stylesplat.stylization.style_config import ColorMode, StyleConfig
from stylesplat.stylization.target import check_size, fits, style_features

COLOR_VIEWS = 8  # whose pixels tell an object's colours
KEPT: dict[ColorMode, float] = {"style": 0.0, "blend": 0.5, "keep": 1.0, "free": 0.0}
STYLE_FEATURES = 4096  # at random, of fine ones, of which there are many
VISITS = 2  # of a view at least: cutting one takes as long as a step
SPLIT_AT = 1  # the stage: Gaussians are fine enough for the one before
SPLIT_VIEWS = 12  # in which sizes are looked up before Gaussians are split


@dataclass(frozen=True)
class StyleJob:
    """One object and the style it is to have."""

    name: str
    """What messages and metrics call it."""
    picked: Bool[Tensor, " N"]
    """Its Gaussians."""
    styles: tuple[Float[Tensor, "_ _ 3"], ...]
    """The style images, colours in 0..1; every feature takes the best match of all."""
    config: StyleConfig
    """Its settings."""


@dataclass(frozen=True)
class Studio:
    """What all jobs share."""

    splats: Splats
    """The scene before."""
    cameras: Cameras
    """Views to optimise on."""
    every_camera: Cameras
    """Those and the held-out ones, in which nothing but the object may change."""
    network: FeatureNetwork
    """Whose features are matched, in float32."""
    precision: torch.dtype
    """Of the features while optimising."""
    max_memory: float
    """Bytes that linear views may take."""


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
    """The same Gaussians with the colours before."""
    parents: Int[Tensor, " N"]
    """Which Gaussian of the scene before each one comes from."""


def repaint(studio: Studio, job: StyleJob) -> Iterator[Repainted]:
    """Repaint one object of a scene.

    Yields:
        The state after every step. Whoever stops asking keeps what there is; whoever asks again
        goes on.

    Raises:
        StyleSplatError: If the object is not seen, or a style image is too small.
    """
    boxes = see_object(studio, job, studio.cameras)
    boxes = evenly(boxes, math.ceil(job.config.view_share * len(boxes)))
    stages = _stages(studio, job, typical_length(boxes))
    seen = _seen(studio, job, boxes, stages[0])
    pictures = _pictures(studio, job, seen)
    palette = torch.cat([picture.reshape(-1, 3) for picture in pictures])
    current = _undercoat(studio, job, seen, palette)
    split = Split(studio.splats, torch.arange(len(studio.splats), device=studio.splats.device))
    generator = torch.Generator().manual_seed(job.config.seed)
    done, views = 0, []
    for number, stage in enumerate(stages):
        views.clear()  # before there are others: they take much memory
        if number == min(SPLIT_AT, len(stages) - 1):
            split = _split(studio, job, boxes, length=stages[-1].lengths[-1])
            current = _with_colors(split, current, job.picked)
            studio = replace(studio, splats=split.splats)
            job = replace(job, picked=job.picked[split.parents])
            seen = _seen(studio, job, boxes, stages[0])
        views += _stage_views(studio, job, boxes, stage, generator)
        objective = _objective(studio, job, pictures, stage)
        objective = replace(objective, shapes=current if stage.window else None)
        for step in optimize_colors(current, job.picked, views, objective, stage.steps):
            done, current = done + 1, step.splats
            if step.number == stage.steps:
                current = _match_palette(studio, job, current, seen, palette)
            planned = job.config.all_steps
            yield Repainted(done, planned, step.nnfm, current, split.splats, split.parents)


def _seen(studio: Studio, job: StyleJob, boxes: Sequence[Box], stage: Stage) -> list[ObjectView]:
    """Small views that tell the object's colours."""
    few, zoom = evenly(boxes, COLOR_VIEWS), stage.lengths[0] / typical_length(boxes)
    return object_views(studio, job, few, zoom, max_memory=math.inf)


def _with_colors(split: Split, current: Splats, picked: Bool[Tensor, " N"]) -> Splats:
    """The children in the colours that their parents have so far."""
    mask = picked[split.parents, None, None]
    return replace(
        split.splats,
        sh0=torch.where(mask, current.sh0[split.parents], split.splats.sh0),
        shN=torch.where(mask, current.shN[split.parents], split.splats.shN),
    )


def _stage_views(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], stage: Stage, generator: torch.Generator
) -> list[ObjectView]:
    """The object or parts of it, in each of the stage's sizes; few steps need few of them."""
    views = []
    for length in stage.lengths:
        zoom = length / typical_length(boxes)
        count = math.ceil(stage.steps / len(stage.lengths) / VISITS)
        if stage.window is None:
            shown = evenly(boxes, count)
        else:
            shown = windows(boxes, stage.window / zoom, count, generator)
        room = studio.max_memory / len(stage.lengths)
        views += object_views(studio, job, shown, zoom, max_memory=room)
    return views


def see_object(studio: Studio, job: StyleJob, cameras: Cameras) -> list[Box]:
    """Where the object shows in some cameras.

    Raises:
        StyleSplatError: If it does nowhere.
    """
    boxes = find_boxes(studio.splats, cameras, job.picked)
    if not boxes:
        raise StyleSplatError(
            f"Cannot stylise {job.name}: it is seen in none of the {len(cameras)} views. "
            f"Pick other Gaussians, or show views of it."
        )
    return boxes


def object_views(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], zoom: float, *, max_memory: float = 0.0
) -> list[ObjectView]:
    """Views of the object, or of its parts, some times as large as in the cameras.

    Raises:
        StyleSplatError: If it is hardly visible in any.
    """
    cells = [studio.network.cells(block) for block in job.config.layers]
    views = cut_views(
        studio.splats,
        boxes,
        job.picked,
        cells,
        zoom=zoom,
        max_memory=max_memory,
    )
    if not views:
        raise StyleSplatError(
            f"Cannot stylise {job.name}: it is hardly visible in the {len(boxes)} views that show "
            f"it. Pick a larger object, or show closer views of it."
        )
    return views


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


def _split(studio: Studio, job: StyleJob, boxes: Sequence[Box], *, length: float) -> Split:
    growth, device = job.config.max_growth, studio.splats.device
    if growth == 1 or job.config.intensity == 0:
        return Split(studio.splats, torch.arange(len(studio.splats), device=device))
    # contributions are known on the CPU only
    studio = replace(studio, splats=studio.splats.to("cpu"))
    job = replace(job, picked=job.picked.cpu())
    few = evenly(boxes, SPLIT_VIEWS)
    zoom = length / typical_length(boxes)
    views = object_views(studio, job, few, zoom, max_memory=math.inf)
    cameras = studio.every_camera
    split = split_large(studio.splats, job.picked, views, cameras=cameras, max_growth=growth)
    return Split(split.splats.to(device), split.parents.to(device))


def _pictures(studio: Studio, job: StyleJob, views: Sequence[ObjectView]) -> list[Tensor]:
    """The style images, in the object's colours as far as these are to be kept."""
    share = KEPT[job.config.color]
    if share == 0:
        return list(job.styles)
    own = object_colors(studio.splats, views)
    matrix, offset = color_map(torch.cat([s.reshape(-1, 3) for s in job.styles]), own)
    return [s.lerp((s @ matrix.T + offset).clamp(0, 1), share) for s in job.styles]


def _undercoat(
    studio: Studio, job: StyleJob, views: Sequence[ObjectView], palette: Tensor
) -> Splats:
    """The colours to start from."""
    splats = studio.splats
    if job.config.color != "free":
        splats = vary_colors(splats, job.picked, seed=job.config.seed)
    splats = _match_palette(studio, job, splats, views, palette)
    if job.config.view_dependence == "drop":
        matte = splats.shN.masked_fill(job.picked[:, None, None], 0)
        splats = replace(splats, shN=matte)
    return splats


def _match_palette(
    studio: Studio, job: StyleJob, splats: Splats, views: Sequence[ObjectView], palette: Tensor
) -> Splats:
    if job.config.color == "free":
        return splats
    return transfer_colors(splats, job.picked, palette, views)


def _objective(
    studio: Studio, job: StyleJob, pictures: Sequence[Tensor], stage: Stage
) -> Objective:
    features = target_features(studio, job.config, pictures, stage.lengths[0])
    if stage.window is not None:
        generator = torch.Generator().manual_seed(job.config.seed)
        features = [_some(group, generator) for group in features]
    return Objective(
        network=studio.network.to(studio.splats.device, studio.precision),
        styles=[build_index(group, studio.precision) for group in features],
        original=studio.splats,
        config=replace(job.config, lr=stage.rate * job.config.lr),
    )


def _some(group: Tensor, generator: torch.Generator) -> Tensor:
    few = torch.randperm(len(group), generator=generator)[:STYLE_FEATURES]
    return group[few.to(group.device)]

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
from stylesplat.stylization.color import color_map, object_colors, transfer_colors
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.object_views import (
    Box,
    ObjectView,
    cut_views,
    find_boxes,
    typical_length,
)
from stylesplat.stylization.objective import Objective
from stylesplat.stylization.optimize import optimize_colors
from stylesplat.stylization.split import Split, split_large
from stylesplat.stylization.style_config import ColorMode, StyleConfig
from stylesplat.stylization.target import check_size, fits, style_features
from stylesplat.stylization.texture import soften
from stylesplat.stylization.undercoat import COLOR_VIEWS, undercoat

KEPT: dict[ColorMode, float] = {"style": 0.0, "blend": 0.5, "keep": 1.0, "free": 0.0}
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
    split = _split(studio, job, boxes, length=stages[-1][0])
    studio = replace(studio, splats=split.splats)
    job = replace(job, picked=job.picked[split.parents])
    current = plain = split.splats
    done, views = 0, []
    for length, steps in stages:
        views.clear()  # before there are others: they take much memory
        views += object_views(studio, job, boxes, length, max_memory=studio.max_memory)
        pictures = _pictures(studio, job, views)
        palette = torch.cat([picture.reshape(-1, 3) for picture in pictures])
        if done == 0:
            plain = soften(plain, job.picked, views, job.config.softened)
            current = undercoat(plain, job.picked, views, palette, job.config)
        objective = _objective(studio, job, pictures, length, plain)
        for step in optimize_colors(current, job.picked, views, objective, steps):
            done, current = done + 1, step.splats
            if step.number == steps:
                current = _match_palette(studio, job, current, views, palette)
            yield Repainted(done, job.config.steps, step.nnfm, current, split.splats, split.parents)


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
    studio: Studio, job: StyleJob, boxes: Sequence[Box], length: float, *, max_memory: float = 0.0
) -> list[ObjectView]:
    """Views of the object in which its longer side has some length.

    Raises:
        StyleSplatError: If it is hardly visible in any.
    """
    cells = [studio.network.cells(block) for block in job.config.layers]
    views = cut_views(
        studio.splats,
        boxes,
        job.picked,
        cells,
        zoom=length / typical_length(boxes),
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


def _stages(studio: Studio, job: StyleJob, photo_length: float) -> list[tuple[float, int]]:
    """Lengths of the object and steps; all at the last length if a style is too small before.

    Raises:
        StyleSplatError: If a style image is too small for that, too.
    """
    config = job.config
    *_, last = stages = config.stages(photo_length)
    styles = (studio.network, config.layers)
    for picture in job.styles:
        check_size(picture, *styles, length=config.scale * last[0])
        if not all(fits(picture, *styles, length=config.scale * length) for length, _ in stages):
            return [(last[0], config.steps)]
    return stages


def _split(studio: Studio, job: StyleJob, boxes: Sequence[Box], *, length: float) -> Split:
    growth, device = job.config.max_growth, studio.splats.device
    if growth == 1 or job.config.intensity == 0:
        return Split(studio.splats, torch.arange(len(studio.splats), device=device))
    # contributions are known on the CPU only
    studio = replace(studio, splats=studio.splats.to("cpu"))
    job = replace(job, picked=job.picked.cpu())
    few = evenly(boxes, SPLIT_VIEWS)
    views = object_views(studio, job, few, length, max_memory=math.inf)
    cameras = studio.every_camera
    split = split_large(studio.splats, job.picked, views, cameras=cameras, max_growth=growth)
    return Split(split.splats.to(device), split.parents.to(device))


def _pictures(studio: Studio, job: StyleJob, views: Sequence[ObjectView]) -> list[Tensor]:
    """The style images, in the object's colours as far as these are to be kept."""
    share = KEPT[job.config.color]
    if share == 0:
        return list(job.styles)
    own = object_colors(studio.splats, evenly(views, COLOR_VIEWS))
    matrix, offset = color_map(torch.cat([s.reshape(-1, 3) for s in job.styles]), own)
    return [s.lerp((s @ matrix.T + offset).clamp(0, 1), share) for s in job.styles]


def _match_palette(
    studio: Studio, job: StyleJob, splats: Splats, views: Sequence[ObjectView], palette: Tensor
) -> Splats:
    if job.config.color == "free":
        return splats
    seen = evenly(views, COLOR_VIEWS)
    return transfer_colors(splats, job.picked, palette, seen)


def _objective(
    studio: Studio, job: StyleJob, pictures: Sequence[Tensor], length: float, original: Splats
) -> Objective:
    features = target_features(studio, job.config, pictures, length)
    return Objective(
        network=studio.network.to(studio.splats.device, studio.precision),
        styles=[build_index(group, studio.precision) for group in features],
        original=original,
        config=job.config,
    )

"""Views of an object to be repainted, as its job wants them."""

import math
from collections.abc import Sequence

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.stylization.object_views import (
    Box,
    ObjectView,
    cut_views,
    find_boxes,
    typical_length,
    windows,
)
from stylesplat.stylization.stages import Stage
from stylesplat.stylization.style_job import Studio, StyleJob

VISITS = 5  # of a view at least: cutting one takes as long as a step
VISITS_OF_PARTS = 2  # of which it takes many to cover the object


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
    views = _cut(studio, job, boxes, zoom, max_memory)
    if not views:
        raise _hardly_visible(job, boxes)
    return views


def stage_views(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], stage: Stage, generator: torch.Generator
) -> list[ObjectView]:
    """The object or parts of it, in each of the stage's sizes; few steps need few of them."""
    views = []
    for length in stage.lengths:
        shown, zoom = _shown(boxes, stage, length, generator)
        room = studio.max_memory / len(stage.lengths)
        views += object_views(studio, job, shown, zoom, max_memory=room)
    return views


def check_visible(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], stage: Stage, generator: torch.Generator
) -> None:
    """Raise the StyleSplatError of `stage_views`, if it has one, after few views if it has none."""
    for length in stage.lengths:
        shown, zoom = _shown(boxes, stage, length, generator)
        if not any(_cut(studio, job, [box], zoom) for box in shown):
            raise _hardly_visible(job, shown)


def _shown(
    boxes: Sequence[Box], stage: Stage, length: float, generator: torch.Generator
) -> tuple[list[Box], float]:
    """What a stage looks at in one of its sizes, and how many times as large as in the cameras."""
    zoom = length / typical_length(boxes)
    visits = VISITS if stage.window is None else VISITS_OF_PARTS
    count = math.ceil(stage.steps / len(stage.lengths) / visits)
    if stage.window is None:
        return evenly(boxes, count), zoom
    return windows(boxes, stage.window / zoom, count, generator), zoom


def _cut(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], zoom: float, max_memory: float = 0.0
) -> list[ObjectView]:
    cells = [studio.network.cells(block) for block in job.config.layers]
    splats = studio.splats
    return cut_views(splats, boxes, job.picked, cells, zoom=zoom, max_memory=max_memory)


def _hardly_visible(job: StyleJob, boxes: Sequence[Box]) -> StyleSplatError:
    return StyleSplatError(
        f"Cannot stylise {job.name}: it is hardly visible in the {len(boxes)} views that show "
        f"it. Pick a larger object, or show closer views of it."
    )

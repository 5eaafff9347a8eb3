"""The numbers by which a stylisation is judged, for each object and for the scene around it."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.consistency import view_consistency
from stylesplat.stylization.measure import changes, object_nnfm
from stylesplat.stylization.repaint import (
    Studio,
    StyleJob,
    object_views,
    see_object,
    target_features,
)
from stylesplat.stylization.statistics import content_ssim, object_statistics_distance
from stylesplat.stylization.views import ObjectView, evenly, find_boxes

LENGTH = 192.0  # pixels; the size of objects at which features are compared, whatever the pattern
VIEWS = 4  # of the object, and of the scene
STATISTICS = (1, 2, 3)  # layer groups whose mean and covariance are compared


@torch.no_grad()
def measure_object(
    studio: Studio, job: StyleJob, styled: Splats, *, fallback: Cameras
) -> dict[str, float]:
    """How close an object is to its style, what is left of it, and whether views agree.

    All features of the style image are searched, in float32.

    Args:
        studio: The scene before, and the views to measure on.
        job: The object and its style.
        styled: The scene after; it may have more Gaussians.
        fallback: Views to measure on if the studio's do not show the object.

    Returns:
        `nnfm_before`, `nnfm_after`, `statistics_before`, `statistics_after` (see
        `style_statistics_distance`), `content_ssim` and what `view_consistency` returns.
    """
    backend = studio.backend
    if not find_boxes(studio.splats, studio.cameras, job.picked, backend=backend):
        studio = replace(studio, cameras=fallback)
    layers = job.config.layers
    views, targets = _object_in_styles(studio, job, layers)
    rest = (views, targets, studio.network, layers)
    numbers = {
        "nnfm_before": object_nnfm(studio.splats, *rest, backend=backend),
        "nnfm_after": object_nnfm(styled, *rest, backend=backend),
    }
    layers = STATISTICS[: len(studio.network.blocks)]
    views, targets = _object_in_styles(studio, job, layers)
    rest = (views, targets, studio.network, layers)
    numbers |= {
        "statistics_before": object_statistics_distance(studio.splats, *rest, backend=backend),
        "statistics_after": object_statistics_distance(styled, *rest, backend=backend),
    }
    cameras = studio.cameras[evenly(range(len(studio.cameras)), VIEWS)]
    similarity = content_ssim(studio.splats, styled, cameras, job.picked, backend=backend)
    if similarity is not None:
        numbers["content_ssim"] = similarity
    consistency = view_consistency(
        studio.splats, styled, studio.cameras, job.picked, backend=backend
    )
    return numbers | consistency


@torch.no_grad()
def measure_changes(
    studio: Studio, styled: Splats, picked: Bool[Tensor, " N"]
) -> dict[str, int | float]:
    """What `changes` finds in a few of the studio's views."""
    cameras = studio.cameras[evenly(range(len(studio.cameras)), VIEWS)]
    return changes(studio.splats, styled, cameras, picked, backend=studio.backend)


def _object_in_styles(
    studio: Studio, job: StyleJob, layers: Sequence[int]
) -> tuple[list[ObjectView], list[Tensor]]:
    """Views of the object, and the features of the style image, for some layer groups."""
    config = replace(job.config, layers=tuple(layers))
    boxes = see_object(studio, job, studio.cameras)
    views = object_views(studio, replace(job, config=config), boxes, LENGTH)
    return evenly(views, VIEWS), target_features(studio, config, job.styles, LENGTH)

"""The numbers by which a stylisation is judged, for each object and for the scene around it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.consistency import view_consistency
from stylesplat.evaluation.measure import changes, object_nnfm
from stylesplat.evaluation.own_distance import own_nnfm, share_of_way
from stylesplat.evaluation.palette import off_palette, palette_distance
from stylesplat.evaluation.statistics import content_ssim, object_statistics_distance
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.colors import object_colors
from stylesplat.stylization.crop_scene import SceneCrop
from stylesplat.stylization.optimize import target_features
from stylesplat.stylization.target import PaintContext, PaintTarget
from stylesplat.stylization.views import (
    Box,
    ObjectView,
    find_boxes,
    object_views,
    require_boxes,
    typical_length,
)

LENGTH = 192.0  # pixels; the size of objects at which features are compared, whatever the pattern
VIEWS = 4  # of the object, and of the scene
STATISTICS = (1, 2, 3)  # layer groups whose mean and covariance are compared


def measure_painted(
    studio: PaintContext,
    jobs: Sequence[PaintTarget],
    styled: Splats,
    *,
    held_out: Cameras | None = None,
    cuts: Mapping[str, SceneCrop] | None = None,
    families: tuple[Int[Tensor, " N"], Int[Tensor, " L"]] | None = None,
) -> dict[str, Any]:
    """What painting some objects did to them and to the scene.

    Args:
        studio: The scene before, and the views that were optimised on.
        jobs: The objects and their styles.
        styled: The scene after; it may have more Gaussians.
        held_out: Views to measure on; those of the studio by default.
        cuts: By name, of a large scene, what objects are measured in, as rows of the base.
        families: The rows of the base that the Gaussians before and after belong to, if there are
            `cuts`.

    Returns:
        What `measure_changes` returns, and by name in `objects` what `measure_object` does.
    """
    base, training = studio.splats, studio.cameras
    measured = replace(studio, cameras=held_out or training)
    jobs = [job.to(base) for job in jobs]
    objects = {}
    for job in jobs:
        if cuts and job.name in cuts:
            assert families is not None
            rows, after = (cuts[job.name].rows_in(each.to(base.device)) for each in families)
            cut = replace(cuts[job.name], rows=rows)
            part, own, after = cut.context(measured), cut.target(job), styled[after]
            fallback = cut.cameras(training)
        else:
            part, own, after, fallback = measured, job, styled, training
        objects[job.name] = measure_object(part, own, after, fallback=fallback)
    picked = torch.stack([job.mask for job in jobs]).any(dim=0)
    return measure_changes(base, styled, measured.cameras, picked) | {"objects": objects}


def measure_object(
    studio: PaintContext, job: PaintTarget, styled: Splats, *, fallback: Cameras
) -> dict[str, float]:
    """How close an object is to its style, what is left of it, and whether views agree.

    What cannot be told, because the style is too small at the size of comparison, is left out.

    Args:
        studio: The scene before, and the views to measure on.
        job: The object and its style.
        styled: The scene after; it may have more Gaussians.
        fallback: Views to measure on if the studio's do not show the object.

    Returns:
        What `measure_style` and `measure_look` return.
    """
    base = studio.splats
    cameras = showing(base, job.mask, studio.cameras, fallback=fallback)
    try:
        numbers = measure_style(replace(studio, cameras=cameras), job, styled)
    except StyleSplatError as error:  # the style is done all the same
        say(f"{job.name} is not compared with its style: {error}")
        numbers = {}
    return numbers | measure_look(base, styled, cameras, job.mask)


@torch.no_grad()
def measure_style(studio: PaintContext, job: PaintTarget, styled: Splats) -> dict[str, float]:
    """How close an object is to its style. Its views and all style features are in float32.

    Args:
        studio: The scene before, and the views to measure on.
        job: The object and its style.
        styled: The scene after; it may have more Gaussians.

    Returns:
        `nnfm_before`, `nnfm_after`, `statistics_before` and `statistics_after` (see
        `style_statistics_distance`); where they can be told, `nnfm_of_style` (see `own_nnfm`) and
        `share_of_way` between what it was and that; where the colours are to be the style's, the
        share `off_palette` that is not, and `palette_distance`.
    """
    layers, boxes = job.config.layers, require_boxes(studio, job, studio.cameras)
    views, targets = _object_in_styles(studio, job, boxes, layers)
    rest = (views, targets, studio.network, layers)
    numbers = {
        "nnfm_before": object_nnfm(studio.splats, *rest),
        "nnfm_after": object_nnfm(styled, *rest),
    }
    numbers |= _way(numbers, studio, job) | _colors(views, job, styled)
    layers = STATISTICS[: studio.network.depth]
    views, targets = _object_in_styles(studio, job, boxes, layers)
    rest = (views, targets, studio.network, layers)
    return numbers | {
        "statistics_before": object_statistics_distance(studio.splats, *rest),
        "statistics_after": object_statistics_distance(styled, *rest),
    }


def _way(nnfm: Mapping[str, float], studio: PaintContext, job: PaintTarget) -> dict[str, float]:
    """How far the style is from itself, and the share of the way there that is done."""
    length = job.config.scale * LENGTH
    own = own_nnfm(job.styles, studio.network, job.config.layers, length=length)
    if own is None:
        return {}
    share = share_of_way(nnfm["nnfm_before"], nnfm["nnfm_after"], own)
    return {"nnfm_of_style": own} | ({} if share is None else {"share_of_way": share})


def _colors(views: Sequence[ObjectView], job: PaintTarget, styled: Splats) -> dict[str, float]:
    """Whether the object's colours are the style's, if they are to be."""
    if job.config.color != "style":
        return {}
    colors = object_colors(styled, views)
    style = torch.cat([picture.reshape(-1, 3) for picture in job.styles])
    return {
        "off_palette": off_palette(colors, style),
        "palette_distance": palette_distance(colors, style),
    }


@torch.no_grad()
def measure_look(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
) -> dict[str, float]:
    """What is left of an object, and whether views agree: what can be told without its style.

    Args:
        base: The scene before.
        styled: The scene after; it may have more Gaussians.
        cameras: The views to measure on.
        picked: The object's Gaussians in `base`.

    Returns:
        `content_ssim`, if it can be told, and what `view_consistency` returns.
    """
    few = cameras[evenly(range(len(cameras)), VIEWS)]
    similarity = content_ssim(base, styled, few, picked)
    numbers = {} if similarity is None else {"content_ssim": similarity}
    return numbers | view_consistency(base, styled, cameras, picked)


@torch.no_grad()
def measure_changes(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
) -> dict[str, int | float]:
    """What `changes` finds in a few of the views."""
    few = cameras[evenly(range(len(cameras)), VIEWS)]
    return changes(base, styled, few, picked)


def showing(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    cameras: Cameras,
    *,
    fallback: Cameras,
) -> Cameras:
    """The cameras, or the others if these do not show the object."""
    return cameras if find_boxes(splats, cameras, picked) else fallback


def _object_in_styles(
    studio: PaintContext, job: PaintTarget, boxes: Sequence[Box], layers: Sequence[int]
) -> tuple[list[ObjectView], list[Tensor]]:
    """Views of the object, and the features of the style image, for some layer groups."""
    config = replace(job.config, layers=tuple(layers))
    zoom = LENGTH / typical_length(boxes)
    views = object_views(studio, replace(job, config=config), boxes, zoom)
    return evenly(views, VIEWS), target_features(studio, config, job.styles, LENGTH)

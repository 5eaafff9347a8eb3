"""The numbers by which a stylisation is judged, for each object and for the scene around it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.consistency import view_consistency
from stylesplat.evaluation.measure import changes, images_nnfm, object_nnfm
from stylesplat.evaluation.own_distance import own_nnfm, share_of_way
from stylesplat.evaluation.palette import off_palette, palette_distance
from stylesplat.evaluation.statistics import content_ssim, object_statistics_distance
from stylesplat.progress import say
from stylesplat.rendering.one_view import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import object_colors
from stylesplat.stylization.cut_scene import CutScene
from stylesplat.stylization.looking import object_views, see_object
from stylesplat.stylization.object_views import (
    Box,
    ObjectView,
    boxes_in,
    find_boxes,
    typical_length,
)
from stylesplat.stylization.paint_objects import moved
from stylesplat.stylization.repaint import target_features
from stylesplat.stylization.style_job import Studio, StyleJob

LENGTH = 192.0  # pixels; the size of objects at which features are compared, whatever the pattern
VIEWS = 4  # of the object, and of the scene
STATISTICS = (1, 2, 3)  # layer groups whose mean and covariance are compared


def measure_painted(
    studio: Studio,
    jobs: Sequence[StyleJob],
    styled: Splats,
    *,
    held_out: Cameras | None = None,
    surveys: Mapping[str, Sequence[Box]] | None = None,
    cuts: Mapping[str, CutScene] | None = None,
    families: tuple[Int[Tensor, " N"], Int[Tensor, " L"]] | None = None,
) -> dict[str, Any]:
    """What painting some objects did to them and to the scene: the numbers that take little time.

    Args:
        studio: The scene before, and the views that were optimised on.
        jobs: The objects and their styles.
        styled: The scene after; it may have more Gaussians.
        held_out: Views to measure on; those of the studio by default.
        surveys: By name, where objects show in the views, if that is known.
        cuts: By name, of a large scene, what objects are measured in, as rows of the base.
        families: The rows of the base that the Gaussians before and after belong to, if there are
            `cuts`.

    Returns:
        What `measure_changes` returns, and by name in `objects` what `measure_style` does. It is
        empty if the style is too small at the size of comparison.
    """
    base, training = studio.splats, studio.cameras
    measured = replace(studio, cameras=held_out or training)
    jobs = [moved(job, base) for job in jobs]
    objects = {}
    for job in jobs:
        if cuts and job.name in cuts:
            assert families is not None
            rows, after = (cuts[job.name].among(each.to(base.device)) for each in families)
            cut = replace(cuts[job.name], rows=rows)
            part, own, after = cut.studio(measured), cut.job(job), styled[after]
        else:
            part, own, after = measured, job, styled
        survey = (surveys or {}).get(job.name)
        if survey is None:
            survey = find_boxes(part.splats, part.every_camera, own.picked)
        boxes = boxes_in(survey, part.cameras) or survey
        try:
            objects[job.name] = measure_style(part, own, after, boxes=boxes)
        except StyleSplatError as error:  # the style is done all the same
            say(f"{job.name} is not compared with its style: {error}")
            objects[job.name] = {}
    picked = torch.stack([job.picked for job in jobs]).any(dim=0)
    return measure_changes(base, styled, measured.cameras, picked) | {"objects": objects}


@torch.no_grad()
def measure_style(
    studio: Studio, job: StyleJob, styled: Splats, *, boxes: Sequence[Box] | None = None
) -> dict[str, float]:
    """Measure how close an object is to its style by NNFM, in float32.

    Args:
        studio: The scene before, and the views to measure on.
        job: The object and its style.
        styled: The scene after; it may have more Gaussians.
        boxes: Where the object shows in these views, if that is known.

    Returns:
        `nnfm_before` and `nnfm_after`; if the pictures are large enough, `nnfm_of_style` (see
        `own_nnfm`), and `share_of_way` between these; if the object is to have the colours of the
        style, the share of it that does not (`off_palette`).

    Raises:
        StyleSplatError: If the object is not visible, or a picture is too small to compare.
    """
    blocks = job.config.layers
    boxes = boxes or see_object(studio, job, studio.cameras)
    views, targets = _object_in_styles(studio, job, boxes, blocks)
    rest = (views, targets, studio.network, blocks)
    images = [render(styled, view.camera)[0].clamp(0, 1) for view in views]
    before, after = object_nnfm(studio.splats, *rest), images_nnfm(images, *rest)
    numbers = {"nnfm_before": before, "nnfm_after": after}
    own = own_nnfm(job.styles, studio.network, blocks, length=job.config.scale * LENGTH)
    if own is not None:
        numbers["nnfm_of_style"] = own
        share = share_of_way(before, after, own)
        numbers |= {} if share is None else {"share_of_way": share}
    if job.config.color == "style":
        colors = [image[view.pixels] for image, view in zip(images, views, strict=True)]
        numbers["off_palette"] = off_palette(torch.cat(colors), _colors(job))
    return numbers


@torch.no_grad()
def measure_statistics(
    studio: Studio, job: StyleJob, styled: Splats, *, boxes: Sequence[Box]
) -> dict[str, float]:
    """Compare the statistics of an object with those of its style.

    Args:
        studio: The scene before.
        job: The object and its style.
        styled: The scene after; it may have more Gaussians.
        boxes: Where the object shows.

    Returns:
        `statistics_before` and `statistics_after` (see `style_statistics_distance`); if the object
        is to have the colours of the style, `palette_distance`.

    Raises:
        StyleSplatError: As `measure_style` does.
    """
    blocks = STATISTICS[: studio.network.depth]
    views, targets = _object_in_styles(studio, job, boxes, blocks)
    rest = (views, targets, studio.network, blocks)
    numbers = {
        "statistics_before": object_statistics_distance(studio.splats, *rest),
        "statistics_after": object_statistics_distance(styled, *rest),
    }
    if job.config.color == "style":
        colors = object_colors(styled, views)
        numbers["palette_distance"] = palette_distance(colors, _colors(job))
    return numbers


def _colors(job: StyleJob) -> Float[Tensor, "P 3"]:
    return torch.cat([picture.reshape(-1, 3) for picture in job.styles])


@torch.no_grad()
def measure_look(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
    *,
    boxes: Sequence[Box] | None = None,
) -> dict[str, float]:
    """What is left of an object, and whether views agree: what can be told without its style.

    Args:
        base: The scene before.
        styled: The scene after; it may have more Gaussians.
        cameras: The views to measure on.
        picked: The object's Gaussians in `base`.
        boxes: Where it shows in these views, if that is known.

    Returns:
        `content_ssim`, if it can be told, and what `view_consistency` returns.
    """
    few = cameras[evenly(range(len(cameras)), VIEWS)]
    similarity = content_ssim(base, styled, few, picked)
    numbers = {} if similarity is None else {"content_ssim": similarity}
    return numbers | view_consistency(base, styled, cameras, picked, boxes=boxes)


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


def _object_in_styles(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], layers: Sequence[int]
) -> tuple[list[ObjectView], list[Tensor]]:
    """Views of the object, and the features of the style image, for some layer groups."""
    config = replace(job.config, layers=tuple(layers))
    zoom = LENGTH / typical_length(boxes)
    views = object_views(studio, replace(job, config=config), boxes, zoom)
    return evenly(views, VIEWS), target_features(studio, config, job.styles, LENGTH)

"""The verb `stylize`: repaint picked Gaussians until they look like a style image."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.photos import read_image
from stylesplat.rendering.rasterize import Backend
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import transfer_colors
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.measure import changes, evenly, object_nnfm
from stylesplat.stylization.optimize import optimize_colors
from stylesplat.stylization.target import style_features
from stylesplat.stylization.views import Box, ObjectView, cut_views, find_boxes, typical_length
from stylesplat.stylization.weights import load_weights

MIN_GAUSSIANS = 50  # fewer cannot show a texture
MEASURED_LENGTH = 192.0  # pixels; the size of objects at which NNFM is reported
MEASURED_VIEWS = 4  # of the object, and of the scene
COLOR_VIEWS = 8  # whose pixels give an object its mean colour


@dataclass(frozen=True)
class StyleJob:
    """One object and the style it is to have."""

    name: str
    """What messages and metrics call it."""
    picked: Bool[Tensor, " N"]
    """Its Gaussians."""
    style: Float[Tensor, "H W 3"]
    """The style image, colours in 0..1."""


def stylize(
    splats: Splats,
    capture: Capture | Cameras,
    picked: Bool[Tensor, " N"],
    style: Path | str | Float[Tensor, "H W 3"],
    *,
    config: StyleConfig | None = None,
    network: FeatureNetwork | None = None,
) -> Splats:
    """Repaint one object in the style of a picture. Only `sh0` and `shN` of it change.

    Args:
        splats: The scene.
        capture: Views from which to look at the object; their photos are not used.
        picked: The object's Gaussians.
        style: A picture's file, or its colours in 0..1.
        config: Settings; see `StyleConfig` and `PRESETS`.
        network: Whose features are matched; VGG16 by default, downloaded once.

    Raises:
        StyleSplatError: As `stylize_objects` does, and if the picture is unreadable.
    """
    config = config or StyleConfig()
    cameras = capture.cameras if isinstance(capture, Capture) else capture
    image = style if isinstance(style, Tensor) else read_image(style) / 255
    network = network or load_weights("vgg16", depth=max(config.blocks))
    job = StyleJob("object", picked, image)
    return stylize_objects(splats, cameras, [job], network, config)[0]


def stylize_objects(
    splats: Splats,
    cameras: Cameras,
    jobs: Sequence[StyleJob],
    network: FeatureNetwork,
    config: StyleConfig | None = None,
    *,
    held_out: Cameras | None = None,
    backend: Backend = "auto",
) -> tuple[Splats, dict[str, Any]]:
    """Repaint several objects, each in its own style and by itself: their order is immaterial.

    Args:
        splats: The scene.
        cameras: Views to optimise on.
        jobs: Which Gaussians take which style.
        network: Whose features are matched.
        config: Settings for all of them.
        held_out: Views to measure on; some of `cameras` by default.
        backend: Of the rasteriser.

    Returns:
        The styled scene, and `seconds`, `steps`, what `measure.changes` returns, and by name in
        `objects` the `nnfm_before` and `nnfm_after`, `seconds`, `steps`, `gaussians`, `views`.

    Raises:
        StyleSplatError: If two objects share Gaussians or a name, an object has too few or is
            not seen, or a style image is too small.
    """
    start = time.perf_counter()
    config = config or StyleConfig()
    _check(jobs)
    held_out = held_out or cameras
    base = styled = splats.detach()
    objects = {}
    scene = _Scene(base, cameras, held_out, network.to(base.device), config, backend)
    jobs = [replace(j, picked=j.picked.to(base.device), style=j.style.to(base.means)) for j in jobs]
    for job in jobs:
        alone, objects[job.name] = _stylize_one(scene, job)
        styled = blend_colors(styled, alone, job.picked, intensity=1.0)
    picked = torch.stack([job.picked for job in jobs]).any(dim=0)
    views = held_out[evenly(range(len(held_out)), MEASURED_VIEWS)]
    metrics = changes(base, styled, views, picked, backend=backend)
    steps = sum(measured["steps"] for measured in objects.values())
    seconds = time.perf_counter() - start
    return styled, {"seconds": seconds, "steps": steps, **metrics, "objects": objects}


@dataclass(frozen=True)
class _Scene:
    """What all jobs share."""

    splats: Splats
    cameras: Cameras
    held_out: Cameras
    network: FeatureNetwork
    config: StyleConfig
    backend: Backend


def _stylize_one(scene: _Scene, job: StyleJob) -> tuple[Splats, dict[str, int | float]]:
    start = time.perf_counter()
    splats, config, backend = scene.splats, scene.config, scene.backend
    boxes = find_boxes(splats, scene.cameras, job.picked, backend=backend)
    if not boxes:
        raise StyleSplatError(
            f"Cannot stylise {job.name}: it is seen in none of the {len(scene.cameras)} views. "
            f"Pick other Gaussians, or show views of it."
        )
    length = float(config.object_size or typical_length(boxes))
    share = evenly(boxes, math.ceil(config.view_share * len(boxes)))
    views = _views(scene, job, share, length)
    targets = _targets(scene, job, length)

    started = splats
    if config.color_transfer:
        seen = evenly(views, COLOR_VIEWS)
        started = transfer_colors(splats, job.picked, job.style, seen, backend=backend)
    moved = optimize_colors(
        *(started, job.picked, views, targets, scene.network),
        config=config,
        title=job.name,
        backend=backend,
    )
    styled = blend_colors(splats, moved, job.picked, config.intensity)
    measured = _measure(scene, job, boxes, styled)
    counts = {"steps": config.steps, "views": len(views), "gaussians": int(job.picked.sum())}
    return styled, {**measured, **counts, "seconds": time.perf_counter() - start}


def _measure(
    scene: _Scene, job: StyleJob, boxes: Sequence[Box], styled: Splats
) -> dict[str, float]:
    """NNFM before and after, on all style features, at one size whatever the settings."""
    if scene.held_out is not scene.cameras:
        unseen = find_boxes(scene.splats, scene.held_out, job.picked, backend=scene.backend)
        boxes = unseen or boxes
    views = evenly(_views(scene, job, boxes, MEASURED_LENGTH), MEASURED_VIEWS)
    targets = _targets(scene, job, MEASURED_LENGTH)
    rest = (views, targets, scene.network, scene.config.blocks)
    return {
        "nnfm_before": object_nnfm(scene.splats, *rest, backend=scene.backend),
        "nnfm_after": object_nnfm(styled, *rest, backend=scene.backend),
    }


def _views(scene: _Scene, job: StyleJob, boxes: Sequence[Box], length: float) -> list[ObjectView]:
    cells = [scene.network.cells(block) for block in scene.config.blocks]
    zoom = length / typical_length(boxes)
    splats, backend = scene.splats, scene.backend
    views = cut_views(splats, boxes, job.picked, cells, zoom=zoom, backend=backend)
    if not views:
        raise StyleSplatError(
            f"Cannot stylise {job.name}: it is hardly visible in the {len(boxes)} views that show "
            f"it. Pick a larger object, or show closer views of it."
        )
    return views


def _targets(scene: _Scene, job: StyleJob, length: float) -> tuple[Tensor, ...]:
    size = scene.config.scale * length
    return style_features(job.style, scene.network, scene.config.blocks, length=size)


def blend_colors(base: Splats, styled: Splats, picked: Tensor, intensity: float) -> Splats:
    """The base with the colours of picked Gaussians moved towards the styled ones.

    Renders are linear in the colours, so this blends the renders.

    Args:
        base: Colours at intensity 0.
        styled: The same Gaussians with their colours at intensity 1.
        picked: Which of them to move.
        intensity: How far; more than 1 goes beyond.
    """
    mask = picked[:, None, None]
    return replace(
        base,
        sh0=torch.where(mask, torch.lerp(base.sh0, styled.sh0, intensity), base.sh0),
        shN=torch.where(mask, torch.lerp(base.shN, styled.shN, intensity), base.shN),
    )


def _check(jobs: Sequence[StyleJob]) -> None:
    if not jobs:
        raise StyleSplatError("Nothing to stylise: name at least one object and its style.")
    for job in jobs:
        count = int(job.picked.sum())
        if count < MIN_GAUSSIANS:
            raise StyleSplatError(
                f"Cannot stylise {job.name}: it has {count} Gaussians, too few for a texture "
                f"(at least {MIN_GAUSSIANS}). Pick more of it."
            )
    for one, other in combinations(jobs, 2):
        shared = int((one.picked & other.picked).sum())
        if one.name == other.name:
            raise StyleSplatError(f"{one.name} was given two styles. Give it one.")
        if shared:
            raise StyleSplatError(
                f"Cannot stylise {one.name} and {other.name} at once: they share {shared} "
                f"Gaussians. Pick objects that do not overlap."
            )

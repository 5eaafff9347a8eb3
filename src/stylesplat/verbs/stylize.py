"""`stylize`: repaint named objects of a scene."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import refuse_occupied
from stylesplat.io.scene_folder import SCENE, Scene, Unsplit, read_scene, write_scene
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.paint_objects import MAX_MEMORY, Styled, stylize_objects
from stylesplat.stylization.repaint import StyleJob
from stylesplat.stylization.style_config import DEFAULT_NETWORK, Network
from stylesplat.stylization.style_images import read_style
from stylesplat.verbs.objects import find_object
from stylesplat.verbs.recipe import StyledObject, write_recipe
from stylesplat.verbs.render import scene_views

PER_RUN = ("seconds", "steps", "gaussians")  # numbers of an object that are not reported by it


def stylize_scene(
    path: Path,
    output: Path,
    objects: Sequence[StyledObject],
    *,
    features: Network = DEFAULT_NETWORK,
    weights: Path | None = None,
    max_memory: float = MAX_MEMORY,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Repaint objects of a scene, each in the style of one or more pictures, into a new scene.

    Returns:
        What `metrics.json` holds: seconds, steps, changed Gaussians, PSNR outside the objects,
        and by object `nnfm_before`, `nnfm_after` and the like.

    Raises:
        StyleSplatError: If an object, picture or weights file is unfit, or `output` is taken.
    """
    if not objects:
        raise StyleSplatError(
            "Nothing to stylise. Pass --style OBJECT=IMAGE at least once, or --recipe FILE."
        )
    if not overwrite:
        refuse_occupied(output, marker=SCENE)
    scene = read_scene(path)
    jobs = style_jobs(scene, objects)
    _refuse_restyling(scene, path, jobs)
    network = load_network(jobs, features, weights)
    training, held_out = working_views(scene)
    styled, measured = stylize_objects(
        *(scene.splats.to(pick_device(device)), training, jobs, network),
        held_out=held_out,
        max_memory=max_memory,
    )
    metrics = flat_metrics(measured)
    recipe = {
        **write_recipe(objects, scene.recipe),
        "features": features,
        "weights": weights and weights.resolve(),
        "scene": (scene.recipe or {}).get("scene", path.resolve()),
    }
    repainted = _with_style(scene, styled, jobs)
    repainted = replace(
        repainted,
        recipe=recipe,
        metrics=metrics | {"train": scene.metrics.get("train", scene.metrics)},
    )
    write_scene(repainted, output, overwrite=overwrite)
    return metrics


def load_network(
    jobs: Sequence[StyleJob], features: Network, weights: Path | None, *, download: bool = True
) -> FeatureNetwork:
    """The network that some jobs need, as deep as the deepest does.

    Raises:
        StyleSplatError: As `load_weights` does.
    """
    depth = max(max(job.config.layers) for job in jobs)
    return load_weights(features, weights, depth=depth, download=download)


def style_jobs(scene: Scene, objects: Sequence[StyledObject]) -> list[StyleJob]:
    """The Gaussians and pictures that are meant.

    Raises:
        StyleSplatError: If the scene has no such object, or a picture is unfit.
    """
    jobs = []
    for each in objects:
        config = each.config
        pictures = [
            read_style(picture, rotate=config.rotate, region=config.region)
            for picture in each.styles
        ]
        picked = find_object(scene, each.name)
        jobs.append(StyleJob(each.name, picked, tuple(pictures), config))
    return jobs


def _refuse_restyling(scene: Scene, path: Path, jobs: Sequence[StyleJob]) -> None:
    """What an object looked like before is kept once, so it has one style."""
    for styled in (scene.recipe or {}).get("objects", []):
        taken = find_object(scene, styled["name"])
        for job in jobs:
            if (taken & job.picked).any():
                raise StyleSplatError(
                    f"{job.name} is styled in {path} already. Change its strength with `adjust`, "
                    f"or start from the scene before: `stylesplat adjust {path} --undo -o SCENE`."
                )


def _with_style(scene: Scene, styled: Styled, jobs: Sequence[StyleJob]) -> Scene:
    """The scene with its new Gaussians, and all that belongs to them; and what undoes it.

    What a label id meant is kept as well: among the new Gaussians it would mean others.
    """
    parents = styled.parents.cpu()
    splats, base = styled.splats.to("cpu"), styled.base.to("cpu")
    picks = scene.picks | {job.name: job.picked for job in jobs}
    colors = {"sh0": base.sh0, "shN": base.shN}
    if scene.base_colors is not None:  # styled before: other objects' colours before that
        colors = {name: tensor[parents] for name, tensor in scene.base_colors.items()}
    full = {"sh0": styled.full.sh0.cpu(), "shN": styled.full.shN.cpu()}
    if scene.style_colors is not None:
        mine = torch.stack([job.picked for job in jobs]).any(dim=0)[parents, None, None]
        earlier = {name: tensor[parents] for name, tensor in scene.style_colors.items()}
        full = {name: torch.where(mine, full[name], earlier[name]) for name in full}
    return replace(
        scene,
        splats=splats,
        picks={name: picked[parents] for name, picked in picks.items()},
        base_colors=colors,
        style_colors=full,
        unsplit=_unsplit(scene, base),
    )


def _unsplit(scene: Scene, base: Splats) -> Unsplit | None:
    """How to undo this split, and those before it."""
    before, known = scene.splats, scene.unsplit
    count = known.count if known else len(before)
    changed = (base.scales[:count] != before.scales[:count]).any(dim=1)
    if known is not None:
        changed[known.rows] = False  # their shapes before are kept already
    if known is None and not changed.any():
        return None
    rows = changed.nonzero()[:, 0]
    found = Unsplit(count, rows, before.scales[rows], before.opacities[rows])
    if known is None:
        return found
    return Unsplit(
        count,
        torch.cat([known.rows, found.rows]),
        torch.cat([known.scales, found.scales]),
        torch.cat([known.opacities, found.opacities]),
    )


def working_views(scene: Scene) -> tuple[Cameras, Cameras | None]:
    """Training views and held-out views, at the size that the scene was trained at."""
    downscale = scene.info.get("settings", {}).get("downscale", 1.0)
    held_out = scene.info.get("test_views", [])
    training = scene_views(scene, "train").downscale(downscale)
    return training, scene_views(scene, "test").downscale(downscale) if held_out else None


def flat_metrics(measured: dict[str, Any]) -> dict[str, Any]:
    """The metrics of `stylize_objects` with one entry per number and object."""
    metrics = {name: value for name, value in measured.items() if name != "objects"}
    for each, numbers in measured["objects"].items():
        for name, value in numbers.items():
            if name not in PER_RUN:
                metrics.setdefault(name, {})[each] = value
    return metrics

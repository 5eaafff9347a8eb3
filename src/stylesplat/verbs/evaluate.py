"""`evaluate`: measure a scene against photos and label maps, and objects against their styles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.evaluation.style import measure_changes, measure_look, measure_style, showing
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.scene_folder import RECIPE, Scene, read_scene, update_scene
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.frames import known_frames, seen_from
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.paint_objects import moved, open_studio
from stylesplat.stylization.style_config import DEFAULT_NETWORK, StyleConfig
from stylesplat.verbs.adjust import unstyled
from stylesplat.verbs.import_splat import MEASURED
from stylesplat.verbs.objects import find_object
from stylesplat.verbs.recipe import read_recipe
from stylesplat.verbs.stylize import flat_metrics, load_network, style_jobs, working_views


def evaluate_scene(
    path: Path, *, capture_path: Path | None = None, masks: Path | None = None, device: str = "auto"
) -> dict[str, Any]:
    """Compare the held-out views of a scene with their photos and label maps.

    Args:
        path: The scene.
        capture_path: The capture that it was trained on; by default where it was then.
        masks: Label maps to compare with; by default the capture's own.
        device: Where to render.

    Returns:
        What `evaluate_views` measures, and of a styled scene what `stylize_scene` did, as far as
        its styles and network are at hand; also written to `metrics.json` under `evaluate`.

    Raises:
        StyleSplatError: If the capture is gone, or the scene has no held-out views.
    """
    scene = read_scene(path)
    source = capture_path or scene.info.get("capture")
    styled = scene.base_colors is not None
    if source is None and not styled:
        raise StyleSplatError(f"{path} does not say what it was trained on. Pass --capture.")
    splats = scene.splats.to(pick_device(device))
    metrics = _photo_metrics(scene, splats, Path(source), masks) if source else {}
    if styled:
        metrics |= _styled_metrics(scene, path, splats)
    update_scene(path, metrics=scene.metrics | {"evaluate": metrics})
    return metrics


def _photo_metrics(
    scene: Scene, splats: Splats, source: Path, masks: Path | None
) -> dict[str, Any]:
    """The held-out views compared with their photos; of an import, some of all."""
    settings = scene.info.get("settings", {})
    capture = load(source, downscale=settings.get("downscale", 1.0), masks=masks)
    if "splat" in scene.info:
        frame = known_frames(capture.cameras)[settings.get("frame", "capture")]
        capture = replace(capture, cameras=seen_from(capture.cameras, frame))
        rows = evenly(range(len(capture.cameras)), MEASURED)
    else:
        rows = [capture.cameras.index(name) for name in scene.info.get("test_views", [])]
    return evaluate_views(splats, capture, rows)


def _styled_metrics(scene: Scene, path: Path, styled: Splats) -> dict[str, Any]:
    """The numbers of `stylize_scene`, its seconds and steps aside."""
    names = [str(how["name"]) for how in (scene.recipe or {}).get("objects", [])]
    if not names:
        return {}
    before = unstyled(scene, path)
    base = before.splats.to(styled.device)
    training, held_out = working_views(scene)
    cameras = held_out or training
    picks = {name: find_object(before, name).to(styled.device) for name in names}
    views = {n: showing(base, mask, cameras, fallback=training) for n, mask in picks.items()}
    closeness = _closeness(before, path, styled, views)
    objects = {
        name: closeness.get(name, {}) | measure_look(base, styled, views[name], picked)
        for name, picked in picks.items()
    }
    every = torch.stack([*picks.values()]).any(dim=0)
    return flat_metrics(measure_changes(base, styled, cameras, every) | {"objects": objects})


def _closeness(
    before: Scene, path: Path, styled: Splats, views: dict[str, Cameras]
) -> dict[str, dict[str, float]]:
    """By object, how close it is to its style; empty if that cannot be told here."""
    try:
        recipe = read_recipe(path / RECIPE, defaults=StyleConfig())
        jobs = style_jobs(before, recipe.objects)
        features = recipe.features or DEFAULT_NETWORK
        network = load_network(jobs, features, recipe.weights, download=False)
        base = before.splats.to(styled.device)
        jobs = [moved(job, base) for job in jobs]
        return {
            job.name: measure_style(open_studio(base, views[job.name], network), job, styled)
            for job in jobs
        }
    except StyleSplatError as error:
        say(f"{path} is not compared with its styles: {error}")
        return {}

"""`stylize`: repaint named objects of a scene."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import refuse_occupied
from stylesplat.io.photos import read_image
from stylesplat.io.scene_folder import SCENE, Scene, read_scene, write_scene
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import Network
from stylesplat.stylization.loop import StyleJob, stylize_objects
from stylesplat.stylization.weights import load_weights
from stylesplat.verbs.objects import find_object
from stylesplat.verbs.render import scene_views


def stylize_scene(
    path: Path,
    output: Path,
    styles: Sequence[tuple[str, Path]],
    *,
    config: StyleConfig,
    features: Network = "vgg16",
    weights: Path | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Repaint objects of a scene, each in the style of a picture, into a new scene.

    Returns:
        What `metrics.json` holds: seconds, steps, changed Gaussians, PSNR outside the objects,
        and by object `nnfm_before` and `nnfm_after`.

    Raises:
        StyleSplatError: If an object, picture or weights file is unfit, or `output` is taken.
    """
    if not styles:
        raise StyleSplatError("Nothing to stylise. Pass --style OBJECT=IMAGE at least once.")
    if not overwrite:
        refuse_occupied(output, marker=SCENE)
    scene = read_scene(path)
    torch_device = pick_device(device)
    jobs = [
        StyleJob(
            name=name,
            picked=find_object(scene, name).to(torch_device),
            style=read_image(image).float() / 255,
        )
        for name, image in styles
    ]
    network = load_weights(features, weights, depth=max(config.blocks), seed=config.seed)
    training, held_out = working_views(scene)
    splats, measured = stylize_objects(
        scene.splats.to(torch_device), training, jobs, network, config, held_out=held_out
    )
    metrics = flat_metrics(measured)
    base_colors = scene.base_colors or {"sh0": scene.splats.sh0, "shN": scene.splats.shN}
    styled = replace(
        scene,
        splats=splats.to("cpu"),
        base_colors=base_colors,
        style_colors=None,
        recipe=_recipe(path, styles, config, features, weights),
        metrics=metrics | {"train": scene.metrics.get("train", scene.metrics)},
    )
    write_scene(styled, output, overwrite=overwrite)
    return metrics


def working_views(scene: Scene) -> tuple[Cameras, Cameras | None]:
    """Training views and held-out views, at the size that the scene was trained at."""
    downscale = scene.info.get("settings", {}).get("downscale", 1.0)
    held_out = scene.info.get("test_views", [])
    training = scene_views(scene, "train").downscale(downscale)
    return training, scene_views(scene, "test").downscale(downscale) if held_out else None


def flat_metrics(measured: dict[str, Any]) -> dict[str, Any]:
    """The metrics of `stylize_objects` with one entry per number and object."""
    metrics = {name: value for name, value in measured.items() if name != "objects"}
    for number in ("nnfm_before", "nnfm_after"):
        metrics[number] = {name: one[number] for name, one in measured["objects"].items()}
    return metrics


def _recipe(
    path: Path,
    styles: Sequence[tuple[str, Path]],
    config: StyleConfig,
    features: Network,
    weights: Path | None,
) -> dict[str, Any]:
    """All that it takes to style the scene again with the same result."""
    return {
        "objects": [
            {"name": name, "style": image.resolve(), "sha256": _digest(image)}
            for name, image in styles
        ],
        "settings": asdict(config),
        "features": features,
        "weights": weights and weights.resolve(),
        "scene": path.resolve(),
    }


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()

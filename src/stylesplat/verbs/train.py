"""`train`: a capture's folder in, a scene's folder out."""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.io.files import refuse_occupied
from stylesplat.io.scene_folder import SCENE, Scene, write_scene
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.training.lifting import lift
from stylesplat.training.loop import fit
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views
from stylesplat.verbs.objects import with_names

Segment = Literal["joint", "lift"]

# By what is learned, so that a run is continued as it began
CHECKPOINTS: dict[Segment, str] = {"joint": "checkpoint.pt", "lift": "checkpoint_lift.pt"}

LIBRARIES = ("stylesplat", "torch", "numba")


def train_scene(
    capture_path: Path,
    output: Path,
    *,
    config: TrainConfig,
    segment: Segment = "joint",
    downscale: float = 1.0,
    masks: Path | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Train a scene, or continue a run that was interrupted.

    Gaussians learn their objects along with their colours (`joint`), or the label maps are lifted
    onto them afterwards (`lift`).

    Returns:
        What `metrics.json` holds: PSNR and SSIM of the held-out views, seconds, steps, Gaussians.

    Raises:
        StyleSplatError: If the capture cannot be read, or `output` holds something else.
    """
    checkpoint = output / CHECKPOINTS[segment]
    unfinished = output.is_dir() and [p.name for p in output.iterdir()] == [checkpoint.name]
    if output.is_file() or not (overwrite or unfinished):
        refuse_occupied(output, marker=SCENE)
    files = open_capture(capture_path, masks=masks)
    capture = files.at(downscale)
    if capture.label_maps is None:
        say("No label maps: training without identities, so objects cannot be selected by id.")
    torch_device = pick_device(device)
    if overwrite:
        checkpoint.unlink(missing_ok=True)
    learned = capture if segment == "joint" else replace(capture, label_maps=None)
    state = fit(learned, config, device=torch_device, checkpoint=checkpoint)
    rows, held_out = split_views(capture, config.test_every)
    splats, seconds = state.splats.detach(), state.seconds
    if segment == "lift" and capture.label_maps is not None:
        start = time.perf_counter()
        splats = _lifted(splats, capture, rows)
        seconds += time.perf_counter() - start
    metrics = evaluate_views(splats, capture, held_out) if held_out else {}
    metrics |= _numbers(state, seconds)
    scene = Scene(
        splats=splats.to("cpu"),
        cameras=files.cameras,
        info={
            "capture": capture_path.resolve(),
            "test_views": [capture.cameras.names[row] for row in held_out],
            "settings": asdict(config)
            | {"downscale": downscale, "segment": segment, "device": torch_device.type},
            "libraries": {name: version(name) for name in LIBRARIES},
        },
        metrics=metrics,
    )
    write_scene(with_names(scene, capture.object_names), output, overwrite=True)
    checkpoint.unlink(missing_ok=True)
    return metrics


def train(
    capture: Capture,
    config: TrainConfig | None = None,
    *,
    device: torch.device | str = "auto",
    **settings: float | int | bool | None,
) -> Splats:
    """Train a splat from posed photos: Gaussians, and identities if there are label maps.

    Args:
        capture: Posed photos, from `load`.
        config: How to train; the default preset if not given.
        device: `auto` takes an NVIDIA GPU where there is one.
        settings: Fields of `TrainConfig` to change, such as `steps=2000`.

    Raises:
        StyleSplatError: If the capture leaves nothing to train on.
    """
    config = replace(config or TrainConfig(), **settings)
    return fit(capture, config, device=pick_device(device)).splats.detach()


def _numbers(state: State, seconds: float) -> dict[str, Any]:
    return {
        "seconds": round(seconds, 2),
        "steps": state.step,
        "gaussians": len(state.splats),
        "steps_per_second": round(state.step / max(state.seconds, 1e-9), 2),
    }


def _lifted(splats: Splats, capture: Capture, rows: Sequence[int]) -> Splats:
    """The splats with labels; without, if there is nothing to lift, for training took long."""
    try:
        return lift(splats, capture, rows=rows)
    except StyleSplatError as error:
        say(f"The scene knows no objects: {error}")
        return splats

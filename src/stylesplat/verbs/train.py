"""`train`: a capture's folder in, a scene's folder out."""

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stylesplat.evaluation.metrics import evaluate_views
from stylesplat.io.files import refuse_occupied
from stylesplat.io.load import load
from stylesplat.io.scene_folder import SCENE, Scene, write_scene
from stylesplat.rendering.device import pick_device
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.progress import progress_bar
from stylesplat.training.views import split_views
from stylesplat.verbs.say import say

CHECKPOINT = "checkpoint.pt"
LIBRARIES = ("stylesplat", "torch", "numba")


def train_scene(
    capture_path: Path,
    output: Path,
    *,
    config: TrainConfig,
    downscale: float = 1.0,
    masks: Path | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Train a scene, or continue a run that was interrupted.

    Returns:
        What `metrics.json` holds: PSNR and SSIM of the held-out views, seconds, steps, Gaussians.

    Raises:
        StyleSplatError: If the capture cannot be read, or `output` holds something else.
    """
    checkpoint = output / CHECKPOINT
    unfinished = output.is_dir() and [p.name for p in output.iterdir()] == [CHECKPOINT]
    if output.is_file() or not (overwrite or unfinished):
        refuse_occupied(output, marker=SCENE)
    full = load(capture_path, masks=masks)
    capture = load(capture_path, downscale=downscale, masks=masks)
    if capture.label_maps is None:
        say("No label maps: training without identities, so objects cannot be selected by id.")
    torch_device = pick_device(device)
    if overwrite:
        checkpoint.unlink(missing_ok=True)
    elif checkpoint.exists():
        say(f"Continuing from {checkpoint}.")
    with progress_bar(config, enabled=True) as report:
        state = fit(capture, config, device=torch_device, checkpoint=checkpoint, on_progress=report)
    splats = state.splats.detach()
    _, held_out = split_views(capture, config.test_every)
    metrics = evaluate_views(splats, capture, held_out) if held_out else {}
    metrics |= {
        "seconds": round(state.seconds, 2),
        "steps": state.step,
        "gaussians": len(splats),
        "steps_per_second": round(state.step / max(state.seconds, 1e-9), 2),
    }
    scene = Scene(
        splats=splats.to("cpu"),
        cameras=full.cameras,
        info={
            "capture": capture_path.resolve(),
            "test_views": [capture.cameras.names[row] for row in held_out],
            "settings": {**asdict(config), "downscale": downscale, "device": torch_device.type},
            "libraries": {name: version(name) for name in LIBRARIES},
        },
        metrics=metrics,
    )
    write_scene(scene, output, overwrite=True)
    checkpoint.unlink(missing_ok=True)
    return metrics

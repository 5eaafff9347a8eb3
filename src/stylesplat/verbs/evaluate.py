"""`evaluate`: measure a scene against photos and label maps."""

from pathlib import Path
from typing import Any

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.metrics import evaluate_views
from stylesplat.io.load import load
from stylesplat.io.scene_folder import read_scene, update_scene
from stylesplat.rendering.device import pick_device


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
        What `evaluate_views` measures; also written to `metrics.json` under `evaluate`.

    Raises:
        StyleSplatError: If the capture is gone, or the scene has no held-out views.
    """
    scene = read_scene(path)
    source = capture_path or scene.info.get("capture")
    if source is None:
        raise StyleSplatError(f"{path} does not say what it was trained on. Pass --capture.")
    downscale = scene.info.get("settings", {}).get("downscale", 1.0)
    capture = load(source, downscale=downscale, masks=masks)
    rows = [capture.cameras.index(name) for name in scene.info.get("test_views", [])]
    metrics = evaluate_views(scene.splats.to(pick_device(device)), capture, rows)
    update_scene(path, metrics=scene.metrics | {"evaluate": metrics})
    return metrics

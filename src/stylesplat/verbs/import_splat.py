"""`import`: a splat of another program in, a scene out; no training."""

import time
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.fit import CLOSER, frame_fits
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.io.files import refuse_occupied
from stylesplat.io.scene_folder import SCENE, Scene, write_scene
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import known_frames, seen_from
from stylesplat.scene.ring import ring_cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.training.lifting import lift
from stylesplat.verbs.objects import with_names

FrameName = Literal["capture", "nerfstudio", "nerfstudio-axes", "nerfstudio-colmap"]
Up = Literal["x", "-x", "y", "-y", "z", "-z"]

WORKING_SIZE = 960  # pixels of the longer side at which labels are lifted and styles matched
CHECK_SIZE = 240  # and at which the fit to the photos is checked
MEASURED = 8  # views that are compared with their photos


def import_splat(
    path: Path,
    output: Path,
    *,
    capture_path: Path | None = None,
    masks: Path | None = None,
    frame: FrameName = "capture",
    up: Up | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Make a scene of a splat file, with the cameras and label maps of a capture if there is one.

    The splat stays as it is in the file: same frame, same Gaussians, same order.

    Args:
        path: A .ply, .spz or .splat.
        output: The scene's folder.
        capture_path: The photos that it was made from. Without them the scene gets cameras on
            circles around the content.
        masks: Folder of label maps; by default the capture's own.
        frame: The world frame of the splat, if it is not the capture's.
        up: Which way is up, for the circles; by default -y, as COLMAP has it.
        device: Where to render.
        overwrite: Whether a scene in `output` may be replaced.

    Returns:
        What `metrics.json` holds: `seconds`, `gaussians`, and with photos `psnr` and `ssim`, with
        label maps `confidence` (mean share of a Gaussian's pixels that have its label),
        `unseen_gaussians`, and `miou` and `boundary_miou` against these same label maps.

    Raises:
        StyleSplatError: If a file is unfit, or the splat does not show what the photos do.
    """
    _refuse_idle_options(capture_path, masks, frame, up)
    if not overwrite:
        refuse_occupied(output, marker=SCENE)
    start = time.perf_counter()
    splats = read_splats(path)
    metrics: dict[str, Any] = {"gaussians": len(splats)}
    settings: dict[str, Any] = {}
    names: Mapping[int, str] = {}
    if capture_path is None:
        cameras = ring_cameras(splats, _direction(up or "-y"))
        say(f"No photos: {len(cameras)} views around the content. `stylesplat render` shows them.")
    else:
        splats = splats.to(pick_device(device))
        files = open_capture(capture_path, masks=masks)
        _check_fit(splats, path, files.at(files.cameras.shrink_to(CHECK_SIZE)), frame)
        cameras = seen_from(files.cameras, known_frames(files.cameras)[frame])
        shrink = cameras.shrink_to(WORKING_SIZE)
        capture = replace(files.at(shrink), cameras=cameras.downscale(shrink))
        splats, found = _with_labels(splats, capture)
        metrics |= found
        settings = {"downscale": shrink, "frame": frame}
        names = capture.object_names
    metrics["seconds"] = round(time.perf_counter() - start, 2)
    info = {
        "splat": path.resolve(),
        "capture": capture_path and capture_path.resolve(),
        "test_views": [],
        "settings": settings,
        "libraries": {"stylesplat": version("stylesplat")},
    }
    scene = Scene(splats=splats.to("cpu"), cameras=cameras, info=info, metrics=metrics)
    write_scene(with_names(scene, names), output, overwrite=overwrite)
    return metrics


def _refuse_idle_options(
    capture_path: Path | None, masks: Path | None, frame: FrameName, up: Up | None
) -> None:
    """Raise a StyleSplatError for options that would change nothing."""
    if capture_path is None and (masks is not None or frame != "capture"):
        raise StyleSplatError("--masks and --frame need the capture. Name its folder as well.")
    if capture_path is not None and up is not None:
        raise StyleSplatError("--up is for splats without photos. Leave it out.")


def _with_labels(splats: Splats, capture: Capture) -> tuple[Splats, dict[str, Any]]:
    """The splats with lifted labels if there are any, and how they compare with the photos."""
    metrics: dict[str, Any] = {}
    if capture.label_maps is None:
        say("No label maps: objects can be picked by --box3d and --sphere only.")
    else:
        splats = lift(splats, capture)
        assert splats.confidence is not None
        seen = splats.confidence[splats.confidence > 0]
        metrics["confidence"] = float(seen.mean())
        metrics["unseen_gaussians"] = len(splats) - len(seen)
    rows = evenly(range(len(capture.cameras)), MEASURED)
    return splats, metrics | evaluate_views(splats, capture, rows)


def _check_fit(splats: Splats, path: Path, small: Capture, frame: FrameName) -> None:
    """Raise a StyleSplatError if renders do not show what the photos do; say which frame does."""
    frames = known_frames(small.cameras)
    gain = frame_fits(splats, small, {frame: frames.pop(frame)})[frame]
    if gain > CLOSER:
        return
    gains = frame_fits(splats, small, frames)
    best = max(gains, key=lambda name: gains[name])
    fault = (
        f"{path} does not show what the photos in {small.path} do (renders are {gain:+.1f} dB "
        "from pictures of one colour)"
    )
    if gains[best] > CLOSER:
        raise StyleSplatError(
            f"{fault}, but it does in the frame of another program. Pass --frame {best}."
        )
    raise StyleSplatError(
        f"{fault}. Give the capture that it was made from, or leave out the capture."
    )


def _direction(up: Up) -> torch.Tensor:
    return torch.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)

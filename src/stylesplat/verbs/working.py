"""A capture at a size to work at, and a splat of it: one that exists, or one trained quickly."""

from dataclasses import dataclass, replace
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.fit import CLOSER, frame_fits
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.io.scene_folder import Scene, read_scene
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import known_frames
from stylesplat.scene.splats import Splats
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig

QUICK = TrainConfig(steps=3000, max_gaussians=30_000, test_every=0, sh_degree=1)
QUICK_SIZE = 480  # pixels of the longer side of its photos
CHECK_SIZE = 240  # and of those that a scene is compared with


@dataclass(frozen=True)
class Working:
    """Photos to work on and what they show in 3D."""

    capture: Capture
    """At working size, without label maps."""
    splats: Splats
    """In the frame of the capture's cameras."""


def working_capture(path: Path, size: int) -> Capture:
    """A capture whose photos are at most so many pixels long, its label maps left out."""
    files = open_capture(path, masks=False)
    return files.at(files.cameras.shrink_to(size))


def with_splat(path: Path, capture: Capture, scene_path: Path | None, device: str) -> Working:
    """A capture with a scene of it, or with a splat that is trained for about a minute.

    Args:
        path: The capture's folder.
        capture: What was read from it, at working size.
        scene_path: A scene of it, if there is one.
        device: Where to compute.

    Raises:
        StyleSplatError: If the scene is of other photos, or shows something else.
    """
    torch_device = pick_device(device)
    if scene_path is None:
        say("Training a quick splat, for about a minute; --scene takes one that you have.")
        small = working_capture(path, QUICK_SIZE)
        state = fit(small, QUICK, device=torch_device)
        return Working(capture, state.splats.detach())
    scene = read_scene(scene_path)
    missing = set(capture.cameras.names) - set(scene.cameras.names)
    if missing:
        raise StyleSplatError(
            f"{scene_path} is a scene of other photos: it has no view {min(missing)}. Give a scene "
            f"of {path}, or leave out --scene."
        )
    splats = scene.splats.to(torch_device)
    small = _seen_by(scene, working_capture(path, CHECK_SIZE))
    fits = frame_fits(splats, small, {"scene": known_frames(small.cameras)["capture"]})
    if fits["scene"] <= CLOSER:
        raise StyleSplatError(
            f"{scene_path} does not show what the photos in {path} do. Give a scene of these "
            "photos, or leave out --scene."
        )
    return Working(_seen_by(scene, capture), splats)


def _seen_by(scene: Scene, capture: Capture) -> Capture:
    """A capture with the cameras of a scene: an import may have moved them."""
    seen = scene.cameras[[scene.cameras.index(name) for name in capture.cameras.names]]
    ratio = capture.cameras.sizes / seen.sizes
    Ks = seen.Ks.clone()
    Ks[:, :2] *= ratio[:, :, None].to(Ks)
    return replace(capture, cameras=replace(seen, Ks=Ks, sizes=capture.cameras.sizes))

"""A splat to work with: one that exists, or one trained quickly; and what was made of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from stylesplat.errors import StyleSplatError
from stylesplat.metrics.frame_fit import CHECK_SIZE, CLOSER, frame_fits
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cache import Lazy
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.frames import SAME, posed_as
from stylesplat.scene.labels import OwnLabels, resize_labels
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig

QUICK = TrainConfig(steps=3000, max_gaussians=30_000, test_every=0, sh_degree=1)
QUICK_SIZE = 480  # pixels of the longer side of its photos


@dataclass(frozen=True)
class Working:
    """Photos to work on and what they show in 3D."""

    capture: Capture
    """At working size, without label maps."""
    splats: Splats
    """In the frame of the capture's cameras."""


def with_splat(capture: Capture, scene: Scene | None, device: str) -> Working:
    """A capture with a scene of it, or with a splat that is trained for about a minute.

    Args:
        capture: At working size; its label maps do not matter.
        scene: A scene of it, if there is one.
        device: Where to compute.

    Raises:
        StyleSplatError: If the scene is of other photos, or shows something else.
    """
    torch_device = pick_device(device)
    capture = replace(capture, label_maps=None, object_names={})
    if scene is None:
        say("Training a quick splat, for a minute or more; --scene takes one that you have.")
        state = fit(at_most(capture, QUICK_SIZE), QUICK, device=torch_device)
        return Working(capture, state.splats.detach())
    missing = set(capture.cameras.names) - set(scene.cameras.names)
    if missing:
        raise StyleSplatError(
            f"This is a scene of other photos: it has no view {min(missing)}. Give a scene of "
            "these photos, or none."
        )
    splats = scene.unpainted.to(torch_device)
    small = posed_as(at_most(capture, CHECK_SIZE), scene.cameras)
    fits = frame_fits(splats, small, {"scene": SAME})
    if fits["scene"] <= CLOSER:
        raise StyleSplatError(
            "The scene does not show what the photos do. Give a scene of these photos, or none."
        )
    return Working(posed_as(capture, scene.cameras), splats)


def with_maps(
    capture: Capture, maps: Sequence[Callable[[], OwnLabels]], names: Mapping[int, str]
) -> Capture:
    """A capture with label maps that were made at another size.

    Args:
        capture: The photos.
        maps: For each photo what makes its label map.
        names: What objects are called, by id.
    """

    def enlarged(row: int) -> OwnLabels:
        return resize_labels(maps[row](), capture.cameras[row].size[::-1])

    made = Lazy([partial(enlarged, row) for row in range(len(capture))])
    return replace(capture, label_maps=made, object_names=dict(names))

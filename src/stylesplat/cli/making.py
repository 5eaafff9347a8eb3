"""The verbs that make scenes and name objects: what they take, and which function does the work.

Libraries are imported when a verb runs, so that `--help` answers at once.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional

from stylesplat.cli.options import Device, Json, Output, Overwrite, given
from stylesplat.cli.parse import parse_box, parse_point


@dataclass(frozen=True)
class Demo:
    """Make a still life, train it, repaint two of its objects and write a report.

    Example: stylesplat demo -o demo
    """

    output: Output = Path("stylesplat-demo")
    """Folder for everything that is made."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.demo.run import run_demo

        return run_demo(self.output, overwrite=self.overwrite)


@dataclass(frozen=True)
class Train:
    """Train a splat with objects from posed photos.

    Example: stylesplat train garden -o garden-scene --downscale 2 --max-seconds 120
    """

    capture: Positional[Path]
    """Folder with photos and COLMAP or transforms.json poses, and label maps in object_mask/."""
    output: Output
    """Folder of the scene to make. A run that was interrupted continues from there."""
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper takes 30,000 steps."""
    steps: int | None = None
    """Optimiser steps, one photo each."""
    max_seconds: float | None = None
    """Train for this long instead of for a number of steps."""
    max_gaussians: int | None = None
    """The number of Gaussians grows up to here."""
    downscale: float = 1.0
    """How many times smaller the photos are made."""
    test_every: int | None = None
    """Every this many photos one is held out to measure quality; 0 trains on all."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.training.config import PRESETS
        from stylesplat.verbs.train import train_scene

        names = ("steps", "max_seconds", "max_gaussians", "test_every", "seed")
        return train_scene(
            self.capture,
            self.output,
            config=replace(PRESETS[self.preset], **given(self, names)),
            downscale=self.downscale,
            masks=self.masks,
            device=self.device,
            overwrite=self.overwrite,
        )


@dataclass(frozen=True)
class Select:
    """Name an object of a scene, by label id, by a box or by a point in a photo.

    Example: stylesplat select garden-scene --name vase --point IMG_0007.jpg:640,420
    """

    scene: Positional[Path]
    """Folder of the scene."""
    name: str
    """What to call the object."""
    id: tuple[int, ...] = ()
    """Label ids, as `objects` lists them."""
    box: str | None = None
    """VIEW:x0,y0,x1,y1 in the photo's pixels: the object that shows most inside."""
    point: str | None = None
    """VIEW:x,y in the photo's pixels: the object that shows there."""
    threshold: float = 0.5
    """Probability of the object above which a Gaussian belongs to it."""
    keep_outliers: FlagCreatePairsOff[bool] = False
    """Keep Gaussians that lie apart from the rest of the object."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.objects import select_object

        return select_object(
            self.scene,
            self.name,
            ids=self.id,
            box=parse_box(self.box) if self.box else None,
            point=parse_point(self.point) if self.point else None,
            threshold=self.threshold,
            remove_outliers=not self.keep_outliers,
        )

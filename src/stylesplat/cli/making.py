"""The verbs that make scenes: what they take, and which function does the work.

Libraries are imported when a verb runs, so that `--help` answers at once.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from stylesplat.cli.options import Device, Json, Output, Overwrite, given


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
    segment: Literal["joint", "lift"] = "joint"
    """How Gaussians learn their objects: with their colours, as in the paper, or by lifting the
    label maps afterwards, which is faster."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.training.train_config import PRESETS
        from stylesplat.verbs.train import train_scene

        names = ("steps", "max_seconds", "max_gaussians", "test_every", "seed")
        return train_scene(
            self.capture,
            self.output,
            config=replace(PRESETS[self.preset], **given(self, names)),
            segment=self.segment,
            downscale=self.downscale,
            masks=self.masks,
            device=self.device,
            overwrite=self.overwrite,
        )


@dataclass(frozen=True)
class Import:
    """Make a scene of a splat that exists already, without training.

    Example: stylesplat import garden.ply garden -o garden-scene
    """

    splat: Positional[Path]
    """A .ply (also SuperSplat's compressed one), .spz or .splat file."""
    output: Output
    """Folder of the scene to make."""
    capture: Positional[Path | None] = None
    """Folder with the posed photos that it was made from, and label maps in object_mask/. Without
    it the scene gets views on circles around the content."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    frame: Literal["capture", "nerfstudio", "nerfstudio-axes", "nerfstudio-colmap"] = "capture"
    """World frame of the splat; an import that does not fit says which one does."""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] | None = None
    """Which way is up, where there is no capture; -y by default."""
    device: Device = "auto"
    """Where to render; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.import_splat import import_splat

        return import_splat(
            self.splat,
            self.output,
            capture_path=self.capture,
            masks=self.masks,
            frame=self.frame,
            up=self.up,
            device=self.device,
            overwrite=self.overwrite,
        )

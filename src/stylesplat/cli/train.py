"""`stylesplat train`."""

import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.arguments import from_config
from stylesplat.cli.command import (
    CONTINUES,
    Answer,
    Device,
    MakingCommand,
    Output,
    describe_scene,
    new_scene,
    pasted,
)
from stylesplat.cli.sfm import find_photos_capture
from stylesplat.io.atomic import partial_of
from stylesplat.io.files import is_there
from stylesplat.progress import Observer, observed, say
from stylesplat.signals import WHOLE
from stylesplat.structure_from_motion.earlier_capture import is_sfm_unfinished
from stylesplat.training.advice import judge
from stylesplat.training.train_config import (
    PRESETS,
    SEGMENTS,
    Segment,
    TrainConfig,
    refuse_two_lengths,
)

SETTINGS = from_config(
    TrainConfig,
    "steps",
    "max_seconds",
    "max_gaussians",
    "test_every",
    "background",
    "color_correction",
    "refine_poses",
    "seed",
    "max_memory",
)
LARGE = 1600  # pixels of a photo's longer side, beyond which INRIA's code makes them smaller too
BUSY = 1.5  # processes that want to run, for each core: others take a third of the time
FINISHES = "`--finish` makes the scene of what there is."


@dataclass(frozen=True)
class Train(MakingCommand):
    """Train a splat with objects from photos.

    Example: stylesplat train garden -o garden-scene --downscale 2 --max-seconds 120
    """

    capture: Positional[Path]
    """Folder with photos and poses of COLMAP, transforms.json (or transforms_train.json) or LLFF,
    and label maps in object_mask/. Of photos without poses, or a video, `sfm` makes a capture
    first, beside the scene."""
    output: Output
    """Folder of the scene to make. An interrupted run is kept beside it, and continues."""
    downscale: float = 1.0
    """How many times smaller the photos are made."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    settings: Annotated[dict[str, Any], SETTINGS] = field(default_factory=dict)
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper takes 30,000 steps."""
    segment: Segment | None = None
    """How Gaussians learn their objects: with their colours, which `--preset paper` does, or by
    lifting the label maps afterwards, the default otherwise."""
    restart: bool = False
    """Forget an interrupted run."""
    finish: bool = False
    """Take no more steps: make the scene of what an interrupted run has reached. `--steps` below
    those taken do the same."""
    device: Device = "auto"

    @property
    def after_interruption(self) -> str:
        if not is_there(self._checkpoint):
            return CONTINUES if is_sfm_unfinished(self.capture, beside=self.output) else WHOLE
        again = "Without `--restart` it goes on where it stopped." if self.restart else CONTINUES
        return f"{again} {FINISHES}"

    @property
    def _segment(self) -> Segment:
        return self.segment or SEGMENTS[self.preset]

    @property
    def _checkpoint(self) -> Path:
        return partial_of(self.output) / f"checkpoint_{self._segment}.pt"

    def run(self) -> Answer:
        from stylesplat.training.checkpoint import require_checkpoint
        from stylesplat.training.state import Ranks

        refuse_two_lengths(self.settings)
        config = replace(PRESETS[self.preset], **self.settings)
        train = partial(
            ss.train,
            config=config,
            segment=self._segment,
            device=self.device,
            checkpoint=self._checkpoint,
            finish=self.finish,
        )
        with Ranks.of_torchrun(self.device) as ranks:
            if ranks.number:  # the first process prints and saves
                with observed(Observer()):
                    ranks.meet()  # the first process has found the poses
                    train(self._capture())
                sys.exit()
            if self.finish:
                self.refuse_given(("restart",), "--finish")
                require_checkpoint(self._checkpoint)
            with new_scene(self.output, overwrite=self.overwrite) as save:
                capture = self._capture()
                if self.restart:
                    self._delete_checkpoints()
                ranks.meet()
                scene = train(capture)
                if "max_seconds" in self.settings:
                    _mention_load()
                save(scene)
                self._delete_checkpoints()
                photos = len(scene.cameras) - len(scene.held_out)
                about = describe_scene(scene, capture, self.output, device=self.device)
        lines = (*self.outcome(scene.metrics, config, photos), *about.lines)
        return Answer({**scene.metrics, **about.values}, lines, about.following)

    def outcome(
        self, metrics: Mapping[str, Any], config: TrainConfig, photos: int
    ) -> Iterator[str]:
        """How far it came; what the PSNR of photos held out means, and what to do about it."""
        psnr, steps = metrics.get("psnr"), metrics["steps"]
        close = "" if psnr is None else f", {psnr:.1f} dB from photos held out"
        yield f"{self.output}: {metrics['gaussians']:,} Gaussians after {steps:,} steps{close}."
        if psnr is not None:
            check = pasted("check", self.capture)
            worth, advice = judge(metrics, config, photos, check=check)
            yield f"That is {worth}: {advice}" if advice else f"That is {worth}."

    def _capture(self) -> "ss.Capture":
        folder = find_photos_capture(self.capture, beside=self.output)
        capture = ss.load(folder, downscale=self.downscale, masks=self.masks)
        longest = int(capture.cameras.sizes.max())
        if longest > LARGE:
            factor = math.ceil(longest / LARGE)
            say(
                f"The photos are {longest} pixels long. `--downscale {factor}` trains "
                f"up to {factor**2} times as fast, and shows as much at usual sizes."
            )
        return capture

    def _delete_checkpoints(self) -> None:
        """Delete what a run has left, and no other file in that folder."""
        partial = self._checkpoint.parent
        with suppress(OSError):
            for file in partial.glob("*checkpoint_*.pt"):
                file.unlink()
            partial.rmdir()  # unless it has other files


def _mention_load() -> None:
    """Say that other programs took the time of a run that was limited by time."""
    load, cores = getattr(os, "getloadavg", lambda: (0.0,))()[0], os.cpu_count() or 1
    if load > BUSY * cores:
        say(
            f"The machine was busy (load {load:.0f} on {cores} cores), so the run took fewer steps "
            "than in so many quiet seconds. Give more --max-seconds, or --steps."
        )

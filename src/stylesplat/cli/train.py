"""`stylesplat train`."""

import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NoReturn

from tyro.conf import FlagCreatePairsOff, Positional

from stylesplat.cli.next_steps import look_lines, next_lines, object_commands
from stylesplat.cli.options import (
    CONTINUES,
    Device,
    Json,
    Output,
    Overwrite,
    Verbose,
    given,
    refuse_given,
)
from stylesplat.cli.posed import is_under_way, posed
from stylesplat.cli.results import save_or_rescue
from stylesplat.cli.scene_pictures import look
from stylesplat.io.atomic import MARK, partial_of
from stylesplat.io.files import is_there
from stylesplat.signals import WHOLE
from stylesplat.training.train_config import PRESETS, SEGMENTS, Segment, TrainConfig

if TYPE_CHECKING:
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene

SETTINGS = (
    "steps",
    "max_seconds",
    "max_gaussians",
    "test_every",
    "color_correction",
    "seed",
    "max_memory",
)
FINISHES = "`--finish` makes the scene of what there is."
KEPT_IN_IT = re.compile(rf"checkpoint_\w+\.pt|\.checkpoint_\w+\.{MARK}\.pt")  # whole, or not


@dataclass(frozen=True)
class Train:
    """Train a splat with objects from photos.

    Example: stylesplat train garden -o garden-scene --downscale 2 --max-seconds 120
    """

    first: ClassVar = ("downscale", "max_seconds", "steps", "masks")
    capture: Positional[Path]
    """Folder with photos and COLMAP or transforms.json poses, and label maps in object_mask/. Of
    photos without poses, or a video, `sfm` makes a capture first, beside the scene."""
    output: Output
    """Folder of the scene to make. An interrupted run is kept beside it, and continues."""
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
    segment: Segment | None = None
    """How Gaussians learn their objects: with their colours, which `--preset paper` does, or by
    lifting the label maps afterwards, the default otherwise."""
    color_correction: Literal["auto", "on", "off"] | None = None
    """Learn each photo's exposure and white balance, and keep them out of the splat. auto, the
    default, does where the photos differ in them; with `--preset paper` off is the default."""
    refine_poses: FlagCreatePairsOff[bool] = False
    """Turn and shift the training photos' cameras a little, where poses are not exact."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    max_memory: float | None = None
    """GiB for photos and label maps, by default 0.25, for a GPU 1; what does not fit is read
    again."""
    overwrite: Overwrite = False
    restart: FlagCreatePairsOff[bool] = False
    """Forget an interrupted run."""
    finish: FlagCreatePairsOff[bool] = False
    """Take no more steps: make the scene of what an interrupted run has reached. `--steps` below
    those taken do the same."""
    verbose: Verbose = False
    json: Json = False

    @property
    def after_interruption(self) -> str:
        """How to go on."""
        if not is_there(self._checkpoint):
            return CONTINUES if is_under_way(self.capture, beside=self.output) else WHOLE
        if self.restart:
            return f"Without `--restart` it goes on where it stopped. {FINISHES}"
        return f"{CONTINUES} {FINISHES}"

    @property
    def _checkpoint(self) -> Path:
        return partial_of(self.output) / f"checkpoint_{self._segment}.pt"

    @property
    def _segment(self) -> Segment:
        return self.segment or SEGMENTS[self.preset]

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.cli.joined import joined
        from stylesplat.io.atomic import changing

        with joined(self.device) as first:
            if not first:
                self._help()
            with changing(self.output):
                return self._train()

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        where = f"{result['gaussians']:,} Gaussians after {result['steps']:,} steps"
        close = f", {result['psnr']:.1f} dB from photos held out" if "psnr" in result else ""
        yield f"{self.output}: {where}{close}."
        yield from look_lines(result)
        yield from next_lines(
            *object_commands(self.output, result["objects"], labelled=result["labelled"])
        )

    def _train(self) -> dict[str, Any]:
        from stylesplat.io.atomic import refuse_occupied
        from stylesplat.io.kinds import SCENE
        from stylesplat.training.checkpoint import require_checkpoint
        from stylesplat.training.state import Ranks

        config, partial = self._config(), self._checkpoint.parent
        if self.finish:
            refuse_given(self, ("restart",), "--finish")
            require_checkpoint(self._checkpoint)
        refuse_occupied(self.output, marker=SCENE, overwrite=self.overwrite)
        capture = self._loaded()
        if self.restart:
            _forget(partial)
        Ranks.here().meet()
        scene = self._trained(capture, config)
        save_or_rescue(scene, self.output, overwrite=self.overwrite)
        _forget(partial)
        return {**scene.metrics, **look(scene, capture, self.output, device=self.device)}

    def _help(self) -> NoReturn:
        """Train with the process that tells and keeps what comes of it."""
        from stylesplat.progress import Silence, observed
        from stylesplat.training.state import Ranks

        with observed(Silence()):
            Ranks.here().meet()  # the poses are found by now
            self._trained(self._loaded(), self._config())
        sys.exit()

    def _loaded(self) -> "Capture":
        from stylesplat.verbs.load import load

        folder = posed(self.capture, beside=self.output)
        return load(folder, downscale=self.downscale, masks=self.masks)

    def _config(self) -> TrainConfig:
        config = replace(PRESETS[self.preset], **given(self, SETTINGS))
        return replace(config, refine_poses=self.refine_poses)

    def _trained(self, capture: "Capture", config: TrainConfig) -> "Scene":
        from stylesplat.verbs.train import train

        return train(
            capture,
            config,
            segment=self._segment,
            device=self.device,
            checkpoint=self._checkpoint,
            finish=self.finish,
        )


def _forget(partial: Path) -> None:
    """Delete what a run has left, and nothing else that lies there."""
    for file in partial.glob("*"):
        if KEPT_IN_IT.fullmatch(file.name):
            with suppress(OSError):
                file.unlink()
    with suppress(OSError):  # there is none, or it is not empty
        partial.rmdir()

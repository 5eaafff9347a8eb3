"""`stylesplat train`."""

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
    shell_command,
)
from stylesplat.cli.sfm import find_photos_capture
from stylesplat.interrupts import WHOLE
from stylesplat.io.atomic import progress_path
from stylesplat.io.files import is_there
from stylesplat.progress import Observer, observed, say
from stylesplat.structure_from_motion.earlier_capture import is_sfm_unfinished
from stylesplat.training.config import (
    SEGMENTS,
    TRAIN_PRESETS,
    Segment,
    TrainConfig,
    refuse_two_lengths,
)

TRAIN_BUSY = 1.5  # processes that want to run, for each core: others take a third of the time
GOOD, FAIR = 27.0, 22.0  # dB of photos held out: sharp as photos are; soft, with objects in place
ENOUGH_STEPS = TrainConfig.steps  # shorter runs gain most by more steps
# dB by which photos trained on may be closer than those held out. The fox, of 50 photos, has a gap
# of 2; of 13 photos one of 7.6, where five times the steps gain 0.8 dB, and the other photos 4
OVERFIT_GAP = 4.0
TRAIN_FEW = 40  # photos, from which on poses are a likelier fault than their number
FINISHES = "`--finish` makes the scene of what there is."

Worth = Literal["good", "fair", "poor"]


@dataclass(frozen=True)
class Train(MakingCommand):
    """Train a splat with objects from photos.

    Example: stylesplat train garden -o garden-scene --max-seconds 120
    """

    capture: Positional[Path]
    """Folder with photos and poses of COLMAP, transforms.json (or transforms_train.json) or LLFF,
    and label maps in object_mask/. Given photos without poses, or a video, `sfm` makes a capture
    first, beside the scene."""
    output: Output
    """Folder of the scene to make. An interrupted run is kept beside it, and continues."""
    downscale: float | None = None
    """How many times smaller the photos are made; 1 trains on all pixels. By default so that the
    default steps take about five minutes on this machine, or `--max-seconds`, but not below 480
    pixels."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    settings: Annotated[dict[str, Any], from_config(TrainConfig)] = field(default_factory=dict)
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper takes 30,000 steps."""
    segment: Segment | None = None
    """How Gaussians learn their objects: with their colours, which `--preset paper` does, or by
    lifting the label maps afterwards, the default otherwise."""
    restart: bool = False
    """Forget an interrupted run."""
    finish: bool = False
    """Stop an interrupted run here and save the scene as it is. A `--steps` that the run has
    passed does the same."""
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
        return progress_path(self.output) / f"checkpoint_{self._segment}.pt"

    def run(self) -> Answer:
        import torch.distributed as dist

        from stylesplat.training.checkpoint import require_checkpoint
        from stylesplat.training.loop import torchrun
        from stylesplat.training.photo_size import for_larger_views

        refuse_two_lengths(self.settings)
        config = replace(TRAIN_PRESETS[self.preset], **self.settings)
        train = partial(
            ss.train,
            config=config,
            segment=self._segment,
            device=self.device,
            checkpoint=self._checkpoint,
            finish=self.finish,
        )
        with torchrun(self.device) as (rank, processes):
            if rank:  # the first process prints and saves
                with observed(Observer()):
                    dist.barrier()  # the first process has found the poses
                    train(self._capture(config, processes))
                sys.exit()
            if self.finish:
                self.refuse_given(("restart",), "--finish")
                require_checkpoint(self._checkpoint)
            with new_scene(self.output, overwrite=self.overwrite) as save:
                capture = self._capture(config, processes)
                if self.restart:
                    self._delete_checkpoints()
                if processes > 1:
                    dist.barrier()
                scene = train(capture)
                if self.downscale is None:
                    scene = for_larger_views(scene)
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
        """How far it came; what the PSNR of photos held out means, and what to do about it.

        Of cut-outs it is that of the object: what is transparent around it is easy to get right.
        """
        psnr, steps = metrics.get("object_psnr", metrics.get("psnr")), metrics["steps"]
        where = " over the object" if "object_psnr" in metrics else ""
        close = "" if psnr is None else f", {psnr:.1f} dB{where} from photos held out"
        yield f"{self.output}: {metrics['gaussians']:,} Gaussians after {steps:,} steps{close}."
        if psnr is not None:
            check = shell_command("check", self.capture)
            worth, advice = judge(metrics, config, photos, check=check)
            yield f"That is {worth}: {advice}" if advice else f"That is {worth}."

    def _capture(self, config: TrainConfig, processes: int) -> "ss.Capture":
        """The capture with photos of the size to train on, that of an interrupted run first."""
        from stylesplat.io.captures.capture_folder import open_capture
        from stylesplat.rendering.render import pick_device
        from stylesplat.training.checkpoint import checkpoint_downscale
        from stylesplat.training.photo_size import affordable_downscale, usual_downscale

        files = open_capture(
            find_photos_capture(self.capture, beside=self.output), masks=self.masks
        )
        earlier = None if self.restart else checkpoint_downscale(self._checkpoint)
        factor = self.downscale if self.downscale is not None else earlier
        if factor is None and processes > 1:  # the others would measure other times
            factor = usual_downscale(files.whole.cameras)
        elif factor is None:
            factor = affordable_downscale(files.at, config, device=pick_device(self.device))
        capture = files.at(factor)
        if factor > 1 and self.downscale is None:
            width, height = max((camera.size for camera in capture.cameras), key=max)
            say(
                f"Training on photos of {width}x{height}, {factor:g} times smaller than they are; "
                "`--downscale 1` trains on all pixels."
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
    if load > TRAIN_BUSY * cores:
        say(
            f"The machine was busy (load {load:.0f} on {cores} cores), so the run took fewer steps "
            "than in so many quiet seconds. Give more --max-seconds, or --steps."
        )


def judge(
    metrics: Mapping[str, Any], config: TrainConfig, photos: int, *, check: str
) -> tuple[Worth, str]:
    """How good the pictures of held-out photos are, and advice; none where they are good."""
    psnr = metrics.get("object_psnr", metrics["psnr"])
    trained = metrics.get("train_object_psnr", metrics["train_psnr"])
    if psnr >= GOOD:
        return "good", ""
    worth = "fair" if psnr >= FAIR else "poor"
    if trained - psnr >= OVERFIT_GAP:
        fact = f"the photos trained on are matched to {trained:.1f} dB, so training is not at fault"
        if photos < TRAIN_FEW:
            return worth, f"{fact}. Take photos from between these {photos}."
        remedy = "" if config.refine_poses else "`--refine-poses` mends inexact poses; "
        return worth, f"{fact}. {remedy}`{check}` says what is wrong with the photos."
    if metrics["steps"] < ENOUGH_STEPS:
        return worth, f"the run was short. Train longer, up to --steps {ENOUGH_STEPS}."
    if metrics["gaussians"] >= config.max_gaussians:
        more = 2 * config.max_gaussians
        return worth, f"it used all Gaussians that it may. Allow more: --max-gaussians {more}."
    return worth, f"more training would hardly help. `{check}` says whether other photos would."

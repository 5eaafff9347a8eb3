"""`stylesplat train`."""

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

import stylesplat as ss
from stylesplat.cli.arguments import from_config, help_texts
from stylesplat.cli.options import CONTINUES, Device, MakingCommand, Output, refuse_given
from stylesplat.cli.results import describe_scene, new_scene, new_scene_lines, pasted
from stylesplat.cli.sfm import find_photos_capture, is_sfm_unfinished
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import partial_of
from stylesplat.io.files import is_there
from stylesplat.progress import Observer, observed, say
from stylesplat.signals import WHOLE
from stylesplat.training.train_config import PRESETS, SEGMENTS, Segment, TrainConfig

SETTINGS = from_config(
    TrainConfig,
    "steps",
    "max_seconds",
    "max_gaussians",
    "test_every",
    "color_correction",
    "seed",
    "max_memory",
)
GOOD, FAIR = 27.0, 22.0  # dB of photos held out: sharp as photos are; soft, with objects in place
ENOUGH = TrainConfig.steps  # shorter runs gain most by more steps
LARGE = 1600  # pixels of a photo's longer side, beyond which INRIA's code makes them smaller too
BUSY = 1.5  # processes that want to run, for each core: others take a third of the time
FINISHES = "`--finish` makes the scene of what there is."
PATIENCE = timedelta(days=7)  # of processes for each other: torchrun ends all when one fails


@dataclass(frozen=True)
class Train(MakingCommand):
    """Train a splat with objects from photos.

    Example: stylesplat train garden -o garden-scene --downscale 2 --max-seconds 120
    """

    capture: Positional[Path]
    """Folder with photos and COLMAP or transforms.json poses, and label maps in object_mask/. Of
    photos without poses, or a video, `sfm` makes a capture first, beside the scene."""
    output: Output
    """Folder of the scene to make. An interrupted run is kept beside it, and continues."""
    downscale: float = 1.0
    """How many times smaller the photos are made."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    settings: Annotated[dict[str, Any], SETTINGS] = field(default_factory=dict)
    refine_poses: Annotated[bool, arg(help=help_texts(TrainConfig)["refine_poses"])] = False
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

    def run(self) -> dict[str, Any]:
        from stylesplat.training.checkpoint import require_checkpoint
        from stylesplat.training.state import Ranks

        config = replace(PRESETS[self.preset], refine_poses=self.refine_poses, **self.settings)
        train = partial(
            ss.train,
            config=config,
            segment=self._segment,
            device=self.device,
            checkpoint=self._checkpoint,
            finish=self.finish,
        )
        with _torchrun(self.device) as is_first:
            if not is_first:  # the first process prints and saves
                with observed(Observer()):
                    Ranks.here().meet()  # the first process has found the poses
                    train(self._capture())
                sys.exit()
            if self.finish:
                refuse_given(self, ("restart",), "--finish")
                require_checkpoint(self._checkpoint)
            with new_scene(self.output, overwrite=self.overwrite) as save:
                capture = self._capture()
                if self.restart:
                    self._delete_checkpoints()
                Ranks.here().meet()
                scene = train(capture)
                if "max_seconds" in self.settings:
                    _mention_load()
                save(scene)
                self._delete_checkpoints()
                described = describe_scene(scene, capture, self.output, device=self.device)
        return {**scene.metrics, **described}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        where = f"{result['gaussians']:,} Gaussians after {result['steps']:,} steps"
        close = f", {result['psnr']:.1f} dB from photos held out" if "psnr" in result else ""
        yield f"{self.output}: {where}{close}."
        if "psnr" in result:
            yield self._verdict(result["psnr"], result["steps"])
        yield from new_scene_lines(result)

    def _verdict(self, psnr: float, steps: int) -> str:
        """What a PSNR of photos held out means, and what to do about it."""
        if psnr >= GOOD:
            return "That is good."
        worth = "fair" if psnr >= FAIR else "poor"
        if steps < ENOUGH:
            return f"That is {worth}, and the run was short: train longer, up to --steps {ENOUGH}."
        check = pasted("check", self.capture)
        return f"That is {worth}: `{check}` says whether other photos would help."

    def _capture(self) -> "ss.Capture":
        folder = find_photos_capture(self.capture, beside=self.output)
        capture = ss.load(folder, downscale=self.downscale, masks=self.masks)
        longest = int(capture.cameras.sizes.max())
        if longest > LARGE:
            factor = math.ceil(longest / LARGE)
            say(
                f"The photos are {longest} pixels long. `--downscale {factor}` trains "
                f"{factor**2} times as fast, and shows as much at usual sizes."
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


@contextmanager
def _torchrun(device: str) -> Iterator[bool]:
    """Join the processes that `torchrun` started, if any; yields whether this is the first one.

    Each process has a GPU of its own, or its share of the cores.
    """
    if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ.get("WORLD_SIZE", "1") == "1":
        yield True
        return
    import numba
    import torch
    import torch.distributed as dist

    from stylesplat.rendering.render import pick_device

    number, count = int(os.environ["LOCAL_RANK"]), int(os.environ["LOCAL_WORLD_SIZE"])
    if pick_device(device).type == "cuda":
        gpus = torch.cuda.device_count()
        if count > gpus:
            raise StyleSplatError(
                f"There are {count} processes for {gpus} GPUs. Give torchrun "
                f"`--nproc-per-node {gpus}`, or train with `--device cpu`."
            )
        torch.cuda.set_device(number)
        backend = "nccl"
    else:
        share = max(1, numba.get_num_threads() // count)
        numba.set_num_threads(share)
        torch.set_num_threads(share)
        backend = "gloo"
    dist.init_process_group(backend, timeout=PATIENCE)
    try:
        yield dist.get_rank() == 0
    finally:
        dist.destroy_process_group()

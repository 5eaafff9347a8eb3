"""Checkpoints: a run on disk, which continues with the same settings and the same capture only."""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import reason
from stylesplat.io.tensors import CLASSIFIER, GAUSSIANS, IDENTITIES, Declared, check_tensors
from stylesplat.progress import say
from stylesplat.scene.capture import differences
from stylesplat.scene.labels import MAX_ID
from stylesplat.training.adam import Moments
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig

FREE = {"max_memory"}  # settings that a run may be continued without: the result is the same
LENGTH = {"steps", "max_seconds"}  # may differ too, if the run takes no more steps
REMEDY = "The same settings and photos continue it; `--restart` begins anew."
CHECKPOINT_SECONDS = 60.0


@dataclass(frozen=True)
class Checkpoint:
    """The file of a run, and what it has to contain for the run to continue."""

    path: Path
    config: TrainConfig
    capture: str
    """Fingerprint of the capture."""
    photos: int = 0
    """How many photos are trained on."""


def save_checkpoint(checkpoint: Checkpoint, state: State) -> None:
    """Write everything that `load_checkpoint` needs; whole or not at all.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    content = {
        "params": {name: t.detach() for name, t in state.params.items()},
        "first": state.moments.first,
        "second": state.moments.second,
        "ids": list(state.ids),
        "counts": [state.first_count, state.step],
        "seconds": state.seconds,
        "config": asdict(checkpoint.config),
        "capture": checkpoint.capture,
    }
    with atomic_path(checkpoint.path) as temporary:
        _write(content, temporary)


def require_checkpoint(path: Path | None) -> None:
    """Raise a StyleSplatError if there is no checkpoint to finish."""
    if path is None or not path.exists():
        fact = "no checkpoint is given" if path is None else f"there is no {path}"
        raise StyleSplatError(
            f"Cannot finish a training: {fact}. Without `--finish` a new training begins."
        )


def load_checkpoint(checkpoint: Checkpoint, device: torch.device, *, finish: bool = False) -> State:
    """The state that `save_checkpoint` wrote; the file stays as it is.

    Args:
        checkpoint: What it has to contain. The length of the run may differ if the steps taken
            suffice for the length wanted.
        device: Where to load it.
        finish: Whether the steps taken suffice in any case.

    Raises:
        StyleSplatError: If the file is damaged, or its run had other settings or another capture.
    """
    path = checkpoint.path
    try:
        _check_sizes(path)
        content = torch.load(path, map_location=device, weights_only=True)
        changed = _changed(content, checkpoint, finish=finish)
        state = None if changed else _state(content, checkpoint)
    except Exception as error:  # torch.load raises half a dozen kinds
        raise StyleSplatError(
            f"Cannot continue from {path}: it is not a checkpoint, or damaged. "
            "`--restart` begins anew."
        ) from error
    if state is None:
        raise StyleSplatError(f"Cannot continue from {path}: it is of {changed}. {REMEDY}")
    return state


def _write(content: dict[str, Any], path: Path) -> None:
    """`torch.save`, which raises OSErrors only if it cannot write."""
    try:
        with path.open("wb") as file:
            torch.save(content, file)
    except RuntimeError as error:  # of its zip writer, after whatever stopped it
        causes: list[BaseException] = [error]
        while causes[-1].__context__ is not None:
            causes.append(causes[-1].__context__)
        raise next((e for e in causes if isinstance(e, OSError)), OSError(reason(error))) from error


def _changed(content: Mapping[str, Any], checkpoint: Checkpoint, *, finish: bool) -> str:
    """How the run of a checkpoint differs from the one wanted; empty if it does not."""
    # A setting that an older version did not have was what is the default now.
    saved, wanted = asdict(TrainConfig()) | content["config"], asdict(checkpoint.config)
    if "capture" not in content:
        return "an older version, which did not record its photos, poses, label maps and size"
    over = finish or checkpoint.config.progress(content["counts"][1], content["seconds"]) >= 1
    free = FREE | LENGTH if over else FREE
    settings = [n for n, value in wanted.items() if n not in free and saved[n] != value]
    changed = [f"a run with another {', '.join(settings)}"] if settings else []
    return ", ".join(changed + differences(content["capture"], checkpoint.capture))


def _check_sizes(path: Path) -> None:
    """Raise a ValueError if a file expands to more than its size; `torch.save` never compresses."""
    if not path.is_file():
        raise ValueError("no plain file")
    with ZipFile(path) as packed:
        if sum(each.file_size for each in packed.infolist()) > path.stat().st_size:
            raise ValueError("it claims to hold more than it does")


def _state(content: Mapping[str, Any], checkpoint: Checkpoint) -> State:
    """The state in a checkpoint; raises a ValueError or a KeyError if it cannot be one."""
    params, ids, config = content["params"], tuple(content["ids"]), checkpoint.config
    (first_count, step), seconds = content["counts"], content["seconds"]
    known = all(isinstance(id, int) and 0 <= id <= MAX_ID for id in ids)
    if not known or len({*ids}) < len(ids):
        raise ValueError("ids are not all different label ids")
    counts_fit = isinstance(first_count, int) and isinstance(step, int) and first_count > 0 <= step
    if not (counts_fit and 0 <= seconds < math.inf):
        raise ValueError("counts of steps, seconds or Gaussians are out of range")
    declared = GAUSSIANS | ({"identities": IDENTITIES} | CLASSIFIER if ids else {})
    corrects = {"on": True, "off": False}.get(config.color_correction, "color_maps" in params)
    if corrects:  # `auto` left this open
        declared |= {"color_maps": Declared(("photos", 3, 4))}
    if config.refine_poses:
        declared |= {"pose_shifts": Declared(("photos", 6))}
    bands = (config.sh_degree + 1) ** 2 - 1
    sizes = {"N": len(params["means"]), "K": len(ids), "bands": bands, "photos": checkpoint.photos}
    check_tensors(params, declared, sizes)
    for low, moments in ((-math.inf, content["first"]), (0.0, content["second"])):
        anything = {n: replace(each, low=low, high=math.inf) for n, each in declared.items()}
        check_tensors(moments, anything, sizes)
    params = {name: t.requires_grad_() for name, t in params.items()}
    moments = Moments(content["first"], content["second"])
    return State(params, moments, ids, first_count, step, seconds)


class Checkpointer:
    """Writes the checkpoints of a run; one that cannot be written costs a line, not the run."""

    def __init__(self, checkpoint: Checkpoint | None, state: State) -> None:
        self._checkpoint = checkpoint
        self._saved_step = state.step  # of the file, if there is one
        self._written = time.monotonic()
        self._fails = False

    def after_step(self, state: State) -> None:
        """Write a checkpoint if it is time; say when writing fails, and when it works again."""
        if self._checkpoint is None or time.monotonic() - self._written <= CHECKPOINT_SECONDS:
            return
        error = self._try(self._checkpoint, state)
        if error is not None and not self._fails:
            say(f"{error} Training goes on without a checkpoint.")
        elif error is None and self._fails:
            say("Checkpoints can be written again.")
        self._fails = error is not None

    def at_end(self, state: State, *, interrupted: bool) -> None:
        """Write the last checkpoint; say so if an interrupted run cannot be saved."""
        if self._checkpoint is None:
            return
        error = self._try(self._checkpoint, state)
        if error is None or (self._fails and not interrupted):
            return
        there = "There is no checkpoint"
        if self._checkpoint.path.exists():
            there = f"The last checkpoint is of step {self._saved_step:,}"
        say(f"{error} {there}, and the run was at step {state.step:,}.")

    def _try(self, checkpoint: Checkpoint, state: State) -> StyleSplatError | None:
        try:
            save_checkpoint(checkpoint, state)
            self._saved_step = state.step
            return None
        except StyleSplatError as error:
            return error
        finally:
            self._written = time.monotonic()

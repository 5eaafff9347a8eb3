"""Checkpoints: a run on disk, which continues with the same settings and the same capture only."""

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import reason
from stylesplat.io.tensors import GAUSSIANS, IDENTITIES, TENSOR_CLASSIFIER, Declared, check_tensors
from stylesplat.progress import say
from stylesplat.training.adam import Moments
from stylesplat.training.config import TrainConfig
from stylesplat.training.state import State

FREE = {"max_memory"}  # settings that a run may be continued without: the result is the same
CHECKPOINT_LENGTH = {"steps", "max_seconds"}  # may differ too, if the run takes no more steps
CHECKPOINT_REMEDY = "The same settings and photos continue it; `--restart` begins anew."
CHECKPOINT_SECONDS = 60.0
SUMS = Declared(("N",), low=0.0, high=math.inf)
REMEMBERED: dict[str, Declared] = {"grad_norms": SUMS, "counts": SUMS}  # by `MCMCStrategy`, or none


@dataclass(frozen=True)
class Checkpoint:
    """The file of a run; the settings and the fingerprint of the capture that continue it."""

    path: Path
    config: TrainConfig
    capture: str
    photos: int = 0
    downscale: float = 1.0


def save_checkpoint(checkpoint: Checkpoint, state: State) -> None:
    """Write everything that `load_checkpoint` needs, without runaways; whole or not at all."""
    state = state.without_runaways()
    content = {
        "params": {name: t.detach() for name, t in state.params.items()},
        "first": state.moments.first,
        "second": state.moments.second,
        "strategy": state.strategy_state,
        "ids": list(state.ids),
        "counts": [state.first_count, state.step],
        "seconds": state.seconds,
        "config": asdict(checkpoint.config),
        "capture": checkpoint.capture,
        "downscale": checkpoint.downscale,
    }
    with atomic_path(checkpoint.path) as temporary:
        try:
            with temporary.open("wb") as file:
                torch.save(content, file)
        except RuntimeError as error:  # of its zip writer, after whatever stopped it
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, OSError):
                cause = cause.__context__
            raise cause or OSError(reason(error)) from error


def require_checkpoint(path: Path | None) -> None:
    """Raise a StyleSplatError if there is no checkpoint to finish."""
    if path is None or not path.exists():
        fact = "no checkpoint is given" if path is None else f"there is no {path}"
        raise StyleSplatError(
            f"Cannot finish a training: {fact}. Without `--finish` a new training begins."
        )


def checkpoint_downscale(path: Path) -> float | None:
    """How many times smaller the photos of a run are; None without a run that can be read."""
    if not path.exists():
        return None
    with suppress(Exception):  # torch.load raises half a dozen kinds; `load_checkpoint` tells them
        return float(torch.load(path, mmap=True, weights_only=True).get("downscale", 1.0))
    return None


def load_checkpoint(checkpoint: Checkpoint, device: torch.device, *, finish: bool = False) -> State:
    """The state that `save_checkpoint` wrote, if the settings and the capture are the same.

    The length of the run may differ from that in `checkpoint.config` if the steps taken suffice for
    it; with `finish` they always do.
    """
    path = checkpoint.path
    try:
        content = torch.load(path, map_location=device, weights_only=True)
        changed = _changed(content, checkpoint, finish=finish)
        state = None if changed else _state(content, checkpoint)
    except Exception as error:  # torch.load raises half a dozen kinds
        raise StyleSplatError(
            f"Cannot continue from {path}: it is not a checkpoint, or damaged. "
            "`--restart` begins anew."
        ) from error
    if state is None:
        raise StyleSplatError(
            f"Cannot continue from {path}: it is of {changed}. {CHECKPOINT_REMEDY}"
        )
    return state


def _changed(content: Mapping[str, Any], checkpoint: Checkpoint, *, finish: bool) -> str:
    """How the run of a checkpoint differs from the one wanted; empty if it does not."""
    # A setting that an older version did not have counts as the default of today
    saved, wanted = asdict(TrainConfig()) | content["config"], asdict(checkpoint.config)
    over = finish or checkpoint.config.progress(content["counts"][1], content["seconds"]) >= 1
    free = FREE | CHECKPOINT_LENGTH if over else FREE
    settings = [n for n, value in wanted.items() if n not in free and saved[n] != value]
    changed = [f"a run with another {', '.join(settings)}"] if settings else []
    if content["capture"] != checkpoint.capture:
        changed.append("another capture (photos, poses, points or label maps)")
    return ", ".join(changed)


def _state(content: Mapping[str, Any], checkpoint: Checkpoint) -> State:
    """The state in a checkpoint; raises a ValueError or a KeyError if it cannot be one."""
    params, ids, config = content["params"], tuple(content["ids"]), checkpoint.config
    declared = GAUSSIANS | ({"identities": IDENTITIES} | TENSOR_CLASSIFIER if ids else {})
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
    first_count, step = content["counts"]
    remembered = content.get("strategy", {})  # older versions remembered nothing
    check_tensors(remembered, REMEMBERED if remembered else {}, sizes)
    counts = first_count, step, content["seconds"]
    return State(params, moments, ids, *counts, strategy_state=remembered)


class Checkpointer:
    """Writes the checkpoints of a run; one that cannot be written costs a line, not the run."""

    def __init__(self, checkpoint: Checkpoint | None) -> None:
        self._checkpoint = checkpoint
        self._written = time.monotonic()
        self._has_failed = False

    def after_step(self, state: State) -> None:
        """Write a checkpoint if it is time; say so the first time that it cannot be written."""
        if time.monotonic() - self._written > CHECKPOINT_SECONDS:
            self.save(state, "Training goes on without it.", always=False)

    def save(self, state: State, consequence: str, *, always: bool) -> None:
        """Write a checkpoint; say if it cannot be written, `always` or the first time only."""
        self._written = time.monotonic()
        try:
            if self._checkpoint is not None:
                save_checkpoint(self._checkpoint, state)
        except StyleSplatError as error:
            if always or not self._has_failed:
                say(f"{error} {consequence}")
            self._has_failed = True

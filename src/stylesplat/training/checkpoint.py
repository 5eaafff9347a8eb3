"""A run on disk, to be continued with the same settings and the same capture only."""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path, reason
from stylesplat.scene.fingerprint import differences
from stylesplat.training.adam import Moments
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig

FREE = {"max_memory"}  # settings that a run may be continued without: the result is the same
REMEDY = "The same settings and photos continue it; `--restart` begins anew."


@dataclass(frozen=True)
class Checkpoint:
    """Where a run is kept, and what it has to be to go on from there."""

    path: Path
    """The file."""
    config: TrainConfig
    """Its settings."""
    capture: str
    """Fingerprint of what it trains on."""


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


def load_checkpoint(checkpoint: Checkpoint, device: torch.device) -> State:
    """The state that `save_checkpoint` wrote; the file stays as it is.

    Raises:
        StyleSplatError: If the file is damaged, or its run had other settings or another capture.
    """
    path = checkpoint.path
    try:
        content = torch.load(path, map_location=device, weights_only=True)
        changed = _changed(content, checkpoint)
        state = None if changed else _state(content)
    except Exception as error:  # torch.load raises half a dozen kinds
        raise StyleSplatError(
            f"Cannot continue from {path}: it is not a checkpoint, or damaged. "
            "`--restart` begins anew."
        ) from error
    if state is None:
        raise StyleSplatError(f"Cannot continue from {path}: it is of {changed}. {REMEDY}")
    return state


def remove_leftovers(path: Path) -> None:
    """Delete the temporary files of a checkpoint whose writing was killed.

    Raises:
        StyleSplatError: If one cannot be deleted.
    """
    ours = re.compile(rf"\.{re.escape(path.stem)}\.[0-9a-f]{{12}}{re.escape(path.suffix)}")
    for file in path.parent.glob(f".{path.stem}.*") if path.parent.is_dir() else ():
        if ours.fullmatch(file.name) and file.is_file():
            try:
                file.unlink(missing_ok=True)
            except OSError as error:
                raise StyleSplatError(f"Cannot delete {file}: {error.strerror}.") from error


def _write(content: dict[str, Any], path: Path) -> None:
    """`torch.save`, raising OSErrors only, if it cannot write."""
    try:
        with path.open("wb") as file:
            torch.save(content, file)
    except RuntimeError as error:  # of its zip writer, after whatever stopped it
        causes: list[BaseException] = [error]
        while causes[-1].__context__ is not None:
            causes.append(causes[-1].__context__)
        raise next((e for e in causes if isinstance(e, OSError)), OSError(reason(error))) from error


def _changed(content: Mapping[str, Any], checkpoint: Checkpoint) -> str:
    """In what the run of a checkpoint differs from another one; empty if in nothing."""
    saved, wanted = content["config"], asdict(checkpoint.config)
    if "capture" not in content:
        return "an older version, which did not note its photos, poses, label maps and size"
    settings = [n for n, value in wanted.items() if n not in FREE and saved.get(n) != value]
    changed = [f"a run with another {', '.join(settings)}"] if settings else []
    return ", ".join(changed + differences(content["capture"], checkpoint.capture))


def _state(content: Mapping[str, Any]) -> State:
    params = {name: t.requires_grad_() for name, t in content["params"].items()}
    moments = Moments(content["first"], content["second"])
    first_count, step = content["counts"]
    return State(params, moments, tuple(content["ids"]), first_count, step, content["seconds"])

"""A run on disk, to be continued with the same settings and the same capture only."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any
from zipfile import ZipFile

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path, left_beside
from stylesplat.io.files import reason
from stylesplat.io.json_files import fitting
from stylesplat.io.tensors import CLASSIFIER, GAUSSIANS, IDENTITIES, Declared, check_tensors
from stylesplat.scene.fingerprint import differences
from stylesplat.scene.labels import MAX_ID
from stylesplat.training.adam import Moments
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig

FREE = {"max_memory"}  # settings that a run may be continued without: the result is the same
LENGTH = {"steps", "max_seconds"}  # may differ too, if the run takes no more steps
REMEDY = "The same settings and photos continue it; `--restart` begins anew."
OF_PHOTOS = {
    "color_maps": Declared(("photos", 3, 4)),
    "pose_shifts": Declared(("photos", 6)),
}
ANY = {"low": -math.inf, "high": math.inf}  # of moments: squares of gradients


class _Parts(msgspec.Struct):
    """What `save_checkpoint` writes of a state."""

    params: dict[str, Tensor]
    first: dict[str, Tensor]
    second: dict[str, Tensor]
    ids: tuple[Annotated[int, Meta(ge=0, le=MAX_ID)], ...]
    counts: tuple[Annotated[int, Meta(ge=1, le=2**53)], Annotated[int, Meta(ge=0, le=2**53)]]
    seconds: Annotated[float, Meta(ge=0, le=1e12)]


@dataclass(frozen=True)
class Checkpoint:
    """Where a run is kept, and what it has to be to go on from there."""

    path: Path
    """The file."""
    config: TrainConfig
    """Its settings."""
    capture: str
    """Fingerprint of what it trains on."""
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


def refuse_unbegun(path: Path | None) -> None:
    """Refuse to finish a run that has no checkpoint.

    Raises:
        StyleSplatError: If there is none.
    """
    if path is None or not path.exists():
        fact = "no checkpoint is given" if path is None else f"there is no {path}"
        raise StyleSplatError(
            f"Cannot finish a training: {fact}. Without `--finish` a new training begins."
        )


def load_checkpoint(checkpoint: Checkpoint, device: torch.device, *, finish: bool = False) -> State:
    """The state that `save_checkpoint` wrote; the file stays as it is.

    Args:
        checkpoint: What it has to be of. The length of the run may be another, if the steps taken
            are enough for the length wanted.
        device: Where to load it.
        finish: Whether they are enough anyway.

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


def remove_leftovers(path: Path) -> None:
    """Delete the temporary files of a checkpoint whose writing was killed.

    Raises:
        StyleSplatError: If one cannot be deleted.
    """
    for file in left_beside(path):
        if file.is_file():
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


def _changed(content: Mapping[str, Any], checkpoint: Checkpoint, *, finish: bool) -> str:
    """In what the run of a checkpoint differs from another one; empty if in nothing."""
    # A setting that an older version did not have was what is the default now.
    saved, wanted = asdict(TrainConfig()) | content["config"], asdict(checkpoint.config)
    if "capture" not in content:
        return "an older version, which did not note its photos, poses, label maps and size"
    over = finish or checkpoint.config.progress(content["counts"][1], content["seconds"]) >= 1
    free = FREE | LENGTH if over else FREE
    settings = [n for n, value in wanted.items() if n not in free and saved[n] != value]
    changed = [f"a run with another {', '.join(settings)}"] if settings else []
    return ", ".join(changed + differences(content["capture"], checkpoint.capture))


def _check_sizes(path: Path) -> None:
    """Raise a ValueError unless a file is what `torch.save` writes, and no larger inside.

    It never compresses; what claims to be larger would fill the memory as it is read.
    """
    if not path.is_file():
        raise ValueError("no plain file")
    with ZipFile(path) as packed:
        if sum(each.file_size for each in packed.infolist()) > path.stat().st_size:
            raise ValueError("it claims to hold more than it does")


def _state(content: Mapping[str, Any], checkpoint: Checkpoint) -> State:
    """The state in a checkpoint of such a run.

    Raises:
        ValueError: If it cannot be one.
    """
    parts = fitting({key: content[key] for key in _Parts.__struct_fields__}, _Parts, "parts", "")
    bands = (checkpoint.config.sh_degree + 1) ** 2 - 1
    declared = GAUSSIANS | ({"identities": IDENTITIES} | CLASSIFIER if parts.ids else {})
    declared |= _of_photos(checkpoint.config, parts.params)
    sizes = {"N": len(parts.params["means"]), "K": len(parts.ids), "bands": bands}
    sizes["photos"] = checkpoint.photos
    if len(set(parts.ids)) < len(parts.ids):
        raise ValueError("ids are not all different")
    check_tensors(parts.params, declared, sizes)
    for moments in (parts.first, parts.second):
        check_tensors(moments, {n: replace(each, **ANY) for n, each in declared.items()}, sizes)
    if any((values < 0).any() for values in parts.second.values()):
        raise ValueError("means of squares are negative")
    first_count, step = parts.counts
    params = {name: t.requires_grad_() for name, t in parts.params.items()}
    moments = Moments(parts.first, parts.second)
    return State(params, moments, parts.ids, first_count, step, parts.seconds)


def _of_photos(config: TrainConfig, params: Mapping[str, Tensor]) -> dict[str, Declared]:
    """What such a run learns of photos; `auto` has left open whether their colours."""
    corrects = {"on": True, "off": False}.get(config.color_correction, "color_maps" in params)
    learned = {"color_maps": corrects, "pose_shifts": config.refine_poses}
    return {name: each for name, each in OF_PHOTOS.items() if learned[name]}

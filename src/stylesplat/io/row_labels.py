"""Labels of Gaussians as other programs keep them beside a splat: one integer each, in order.

Nothing is unpickled, and what a header claims is checked before memory is taken for it.
"""

import io
import math
import zipfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import torch
from jaxtyping import Int, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import read_bytes, reason
from stylesplat.io.npy import DAMAGED, WHOLE, read_member, read_npy
from stylesplat.io.ply import read_ply_table
from stylesplat.scene.labels import MAX_ID

NAMES = ("labels", "label", "object_ids", "object_id", "ids", "id")  # of arrays and columns
MAX_FILE = 2**30  # bytes: a hundred million labels


class _Labels(msgspec.Struct):
    """JSON that is no list."""

    labels: list[int]


def read_row_labels(path: Path | str, count: int) -> Int[Tensor, " N"]:
    """Read one label per Gaussian: a .npy, .npz or .json file, or a column of a .ply.

    An .npz may have several arrays, a .ply has several columns: then `labels`, `label`,
    `object_id` or `id` is meant. JSON is a list, or has it under `labels`.

    Args:
        path: The file.
        count: How many Gaussians there are.

    Raises:
        StyleSplatError: If the file is missing, damaged or of another kind, holds anything but
            integers from 0 to 16777215, or another number of them.
    """
    path = Path(path)
    readers: dict[str, Callable[[Path, int], np.ndarray]] = {
        ".npy": _read_npy,
        ".npz": _read_npz,
        ".json": _read_json,
        ".ply": _read_ply,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise StyleSplatError(
            f"Cannot read labels from {path}: unknown suffix {path.suffix!r}. Save one integer "
            f"per Gaussian as {', '.join(readers)}."
        )
    try:
        values = reader(path, count)
        _check(values, count)
    except DAMAGED as error:
        raise StyleSplatError(f"Cannot read labels from {path}: {reason(error)}.") from error
    return torch.from_numpy(values.reshape(count).astype(np.int64))


def _content(path: Path) -> bytes:
    return read_bytes(path, most=MAX_FILE)


def _read_npy(path: Path, count: int) -> Shaped[np.ndarray, "..."]:
    return read_npy(io.BytesIO(_content(path)), lambda shape: _check_count(shape, count))


def _read_npz(path: Path, count: int) -> Shaped[np.ndarray, "..."]:
    with zipfile.ZipFile(io.BytesIO(_content(path))) as archive:
        names = {Path(name).stem: name for name in archive.namelist() if name.endswith(".npy")}
        name = names[_meant([*names], "array")]
        return read_member(archive, name, lambda shape: _check_count(shape, count))


def _read_json(path: Path, count: int) -> Shaped[np.ndarray, "..."]:
    content = _content(path).strip()
    if content.startswith(b"["):
        values = msgspec.json.decode(content, type=list[int])
    else:
        values = msgspec.json.decode(content, type=_Labels).labels
    return np.array(values, np.int64)


def _read_ply(path: Path, count: int) -> Shaped[np.ndarray, "..."]:
    table = read_ply_table(path)
    column = table[_meant([*(table.dtype.names or ())], "column", alone=False)]
    if column.dtype.kind not in WHOLE and not (np.mod(column, 1) == 0).all():
        raise ValueError("its labels are not whole numbers")
    return column


def _meant(names: list[str], what: str, *, alone: bool = True) -> str:
    """Which of some arrays or columns has the labels."""
    if alone and len(names) == 1:
        return names[0]
    found = next((name for name in NAMES if name in names), None)
    if found is None:
        raise ValueError(f"no {what} of it is called {NAMES[0]}, {NAMES[1]} or {NAMES[3]}")
    return found


def _check_count(shape: tuple[int, ...], count: int) -> None:
    """Raise a ValueError unless so many numbers stand in one line or column."""
    if math.prod(shape) != count or {*shape} - {1, count}:
        has = " x ".join(f"{size:,}" for size in shape) or "1"
        raise ValueError(
            f"it has {has} labels, but there are {count:,} Gaussians. Give one for each, in the "
            "splat's order"
        )


def _check(values: Shaped[np.ndarray, "..."], count: int) -> None:
    _check_count(values.shape, count)
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > MAX_ID:
        raise ValueError(
            f"its labels go from {low} to {high}. Use 0 for what is no object, and up to {MAX_ID}"
        )

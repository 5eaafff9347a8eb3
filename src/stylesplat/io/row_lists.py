"""Which Gaussians are meant, as other programs say it: rows, masks, a selection of SuperSplat."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Int, Shaped
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import brief, some
from stylesplat.io.files import read_bytes, reason
from stylesplat.io.npy import DAMAGED, WHOLE, read_member, read_npy
from stylesplat.io.object_files import at_most, cannot_list, objects_in
from stylesplat.io.ply import read_ply_table
from stylesplat.io.row_labels import MAX_FILE
from stylesplat.scene.scene import ListedObjects

STATE = "state"  # SuperSplat's column in a .ply, whose first bit means selected

Natural = Annotated[int, Meta(ge=0, le=2**31)]


class _Rows(msgspec.Struct):
    rows: list[Natural]


def read_rows(path: Path | str, count: int, name: str) -> Bool[Tensor, " N"]:
    """Read which Gaussians are meant.

    A file that `write_objects` made, of which the object of that name is meant, or the only one; a
    list of row numbers, or a mask, in .npy, .npz or .json; or a .ply with the column `state`, in
    which SuperSplat has what is selected.

    Args:
        path: The file.
        count: How many Gaussians there are.
        name: Of the object.

    Raises:
        StyleSplatError: If the file is missing, damaged or of another kind, or rows are not there.
    """
    path = Path(path)
    listed = objects_in(path, count)
    if listed is not None:
        return _mask(_meant(listed, path, name), count, path)
    try:
        return _mask(_plain_rows(path, count), count, path)
    except DAMAGED as error:
        raise cannot_list(path, reason(error)) from error


def _meant(listed: ListedObjects, path: Path, name: str) -> Shaped[np.ndarray, " M"]:
    objects = [*listed.objects]
    key = name if name in objects or len(objects) != 1 else objects[0]
    if key not in objects:
        fault = f"it has no object {brief(name)!r}, but {some(objects) or 'none'}"
        raise cannot_list(path, f"{fault}. Give the object one of these names")
    return listed.objects[key].rows.numpy()


def _mask(rows: Shaped[np.ndarray, " M"], count: int, path: Path) -> Bool[Tensor, " N"]:
    mask = torch.zeros(count, dtype=torch.bool)
    if rows.dtype.kind == "b":
        if len(rows) != count:
            raise cannot_list(path, f"it is a mask of {len(rows):,}, there are {count:,}")
        rows = rows.nonzero()[0]
    if not len(rows):
        raise cannot_list(path, "it names no Gaussian")
    if rows.min() < 0 or rows.max() >= count:
        fault = f"it names rows {rows.min()} to {rows.max()}, there are 0 to {count - 1}"
        raise cannot_list(path, fault)
    mask[torch.from_numpy(rows.astype(np.int64))] = True
    return mask


def _plain_rows(path: Path, count: int) -> Shaped[np.ndarray, " M"]:
    readers: dict[str, Callable[[], np.ndarray]] = {
        ".npy": lambda: _array(path, count),
        ".npz": lambda: _only_array(path, count),
        ".json": lambda: _json_rows(path),
        ".ply": lambda: _selected(path, count),
    }
    if path.suffix.lower() not in readers:
        raise cannot_list(path, f"unknown suffix {path.suffix!r}. Save {', '.join(readers)}")
    return readers[path.suffix.lower()]()


def _array(path: Path, count: int) -> Shaped[np.ndarray, " M"]:
    read_bytes(path, most=MAX_FILE, first=1)
    with path.open("rb") as stream:
        return read_npy(stream, at_most(count), kinds=WHOLE + "b")


def _only_array(path: Path, count: int) -> Shaped[np.ndarray, " M"]:
    read_bytes(path, most=MAX_FILE, first=1)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if len(names) != 1:
            raise ValueError(f"it holds {some(names)}, of which one could be meant")
        return read_member(archive, names[0], at_most(count), kinds=WHOLE + "b")


def _json_rows(path: Path) -> Int[np.ndarray, " M"]:
    content = read_bytes(path, most=MAX_FILE).strip()
    if content.startswith(b"["):
        return np.array(msgspec.json.decode(content, type=list[Natural]), np.int64)
    return np.array(msgspec.json.decode(content, type=_Rows).rows, np.int64)


def _selected(path: Path, count: int) -> Bool[np.ndarray, " N"]:
    """What SuperSplat had selected when it wrote a .ply."""
    table = read_ply_table(path)
    if STATE not in (table.dtype.names or ()):
        raise ValueError(f"it has no column {STATE!r}, in which SuperSplat has what is selected")
    if len(table) != count:
        raise ValueError(f"it has {len(table):,} Gaussians, there are {count:,}")
    return (table[STATE].astype(np.int64) & 1).astype(bool)

"""Which Gaussians are meant, on disk: objects, a label each, rows, masks.

`write_objects` makes an .npz of `gaussians` (their number), `labels` if there are any, and for each
object `NAME.rows`, `NAME.ids` and, if known, `NAME.shares`. Files of other programs are read as a
label for each Gaussian (`read_objects`) or as a selection (`read_rows`). Nothing is unpickled, and
the sizes that a header claims are checked before memory is allocated for them.
"""

import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Int, Shaped
from torch import Tensor

from stylesplat.errors import join_names, shorten
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes, reading
from stylesplat.io.ply import read_ply_table
from stylesplat.scene.capture import MAX_ID
from stylesplat.scene.objects import ListedObject, ListedObjects, is_id, name_fault

LISTS = ".npz"  # what `write_objects` makes
SIDECAR = ".objects.npz"  # follows the name of a splat's file
ROWS, SHARES, IDS, COUNT, LABELS = ".rows", ".shares", ".ids", "gaussians", "labels"
LABEL_NAMES = ("labels", "label", "object_ids", "object_id", "ids", "id")  # of arrays and columns
STATE = "state"  # SuperSplat's column in a .ply, whose first bit means selected
ROW_NAMES = (STATE, "rows", "mask")
READABLE = (".npy", ".npz", ".ply")
MAX_FILE = 2**30  # bytes: a hundred million labels
LIST_MAX_HEADER = 2**16  # bytes of the header of an array
MAX_ITEM = 16  # bytes of a number
LIST_REMEDY = "The manual's section on `import` says what can be read."
Array = Shaped[np.ndarray, "..."]


def write_objects(listed: ListedObjects, path: Path | str) -> None:
    arrays = {COUNT: np.array(listed.count)}
    if listed.labels is not None:
        arrays[LABELS] = listed.labels.to(torch.int32).numpy()
    for name, each in listed.objects.items():
        arrays[name + ROWS] = each.rows.to(torch.int32).numpy()
        arrays[name + IDS] = np.array(each.ids, np.int32)
        if each.shares is not None:
            arrays[name + SHARES] = each.shares.float().numpy()
    with atomic_path(path) as draft:
        np.savez_compressed(draft, allow_pickle=False, **arrays)


def read_objects(path: Path | str, count: int) -> ListedObjects:
    """Read the objects of `count` Gaussians: a file of `write_objects`, or a label for each.

    Labels are integers from 0 to 16777215: a .npy, or the array of an .npz or column of a .ply that
    is called `labels`, `label`, `object_id` or `id`.
    """
    path = Path(path)
    with reading(path, LIST_REMEDY):
        found = _read(path, count, LABEL_NAMES)
        if isinstance(found, ListedObjects):
            return found
        if found.size != count:
            has = " x ".join(f"{size:,}" for size in found.shape) or "1"
            raise ValueError(f"it has {has} labels, but there are {count:,} Gaussians")
        return ListedObjects(count, labels=_integers(found.reshape(count), MAX_ID, "labels"))


def read_rows(path: Path | str, count: int, name: str) -> Bool[Tensor, " N"]:
    """Read a selection of `count` Gaussians as a mask.

    Takes a file of `write_objects`, of which the object `name` or the only one is read; row numbers
    or a mask in .npy or .npz; or a .ply with SuperSplat's column `state`.
    """
    path = Path(path)
    with reading(path, LIST_REMEDY):
        found = _read(path, count, ROW_NAMES)
        if isinstance(found, ListedObjects):
            objects = [*found.objects]
            key = name if name in objects or len(objects) != 1 else objects[0]
            if key not in objects:
                raise ValueError(
                    f"it has no object {shorten(name)!r}, but {join_names(objects) or 'none'}"
                )
            found = found.objects[key].rows.numpy()
        elif path.suffix.lower() == ".ply":
            found = (found.astype(np.int64) & 1).astype(bool)
        if found.dtype.kind == "b":
            if found.shape != (count,):
                raise ValueError(f"it is a mask of {found.size:,} Gaussians, there are {count:,}")
            found = found.nonzero()[0]
        if found.size > count:
            raise ValueError(f"it has {found.size:,} rows, there are {count:,} Gaussians")
        rows = _integers(found, count - 1, "rows")
        if not len(rows):
            raise ValueError("it names no Gaussian")
    mask = torch.zeros(count, dtype=torch.bool)
    mask[rows] = True
    return mask


def _read(path: Path, count: int, names: Sequence[str]) -> ListedObjects | Array:
    """What `write_objects` wrote, or the array or column that has one of these names."""
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise ValueError(f"unknown suffix {path.suffix!r}. Save {', '.join(READABLE)}")
    if suffix == ".ply":
        table = read_ply_table(path)
        return table[_choice(table.dtype.names or (), names)]
    read_bytes(path, most=MAX_FILE, first=1)  # reports a file that cannot be read
    with warnings.catch_warnings(action="ignore"):  # of headers that Python 2 wrote
        if suffix == ".npy":
            return np.load(path, mmap_mode="r", allow_pickle=False)
        with zipfile.ZipFile(path):  # np.load would take it for a pickle
            pass
        with np.load(path, allow_pickle=False) as archive:
            return _read_npz(archive, count, names)


def _choice(found: Sequence[str], names: Sequence[str]) -> str:
    for name in names:
        if name in found:
            return name
    raise ValueError(
        f"it holds {join_names([*found])}, but nothing called {' or '.join(names[:3])}"
    )


def _read_npz(archive: Any, count: int, names: Sequence[str]) -> ListedObjects | Array:
    def array(key: str) -> Array | None:
        if key not in archive.files:
            return None
        size = archive.zip.getinfo(f"{key}.npy").file_size
        if size > LIST_MAX_HEADER + MAX_ITEM * max(count, 1):
            raise ValueError(
                f"{shorten(key)!r} has {size:,} bytes, too many for {count:,} Gaussians"
            )
        return archive[key]

    gaussians = array(COUNT)
    if gaussians is None:
        files = archive.files
        found = array(files[0] if len(files) == 1 else _choice(files, names))
        assert found is not None
        return found
    labels, listed = array(LABELS), dict[str, ListedObject]()
    if gaussians != count or (labels is not None and len(labels) != count):
        raise ValueError(f"it is about {int(gaussians):,} Gaussians, there are {count:,}")
    for key in archive.files:
        if key.endswith(ROWS):
            name = key.removesuffix(ROWS)
            listed[name] = _listed(name, [array(name + end) for end in (ROWS, SHARES, IDS)], count)
    labels = None if labels is None else _integers(labels, MAX_ID, "labels")
    return ListedObjects(count, listed, labels)


def _listed(name: str, arrays: Sequence[Array | None], count: int) -> ListedObject:
    """An object of rows, shares and ids; a ValueError if it is not one of `count` Gaussians."""
    fault = None if is_id(name) else name_fault(name)
    if fault:
        raise ValueError(f"no object is called {shorten(name)!r}, for {fault}")
    rows = _integers(arrays[0], count - 1, f"rows of {shorten(name)!r}")
    if not len(rows):
        raise ValueError(f"{shorten(name)!r} has no rows")
    shares = None
    if arrays[1] is not None:
        shares = torch.from_numpy(np.asarray(arrays[1], np.float32))
        if shares.shape != rows.shape or not ((shares >= 0) & (shares <= 1)).all():
            fault = "are not one from 0 to 1 for each row"
            raise ValueError(f"the shares of {shorten(name)!r} {fault}")
    ids = [] if arrays[2] is None else arrays[2]
    ids = _integers(ids, MAX_ID, f"label ids of {shorten(name)!r}")
    return ListedObject(rows, shares, tuple(ids.tolist()))


def _integers(values: Any, most: int, what: str) -> Int[Tensor, " M"]:
    """A list of integers from 0 to `most`; `what` they are is said of others."""
    found = np.asarray(values)
    if found.dtype.kind == "f" and (np.mod(found, 1) == 0).all():  # PLY has them so
        found = found.astype(np.int64)
    if found.dtype.kind not in "iu":
        raise ValueError(f"it holds {found.dtype}, not integers. Save it with .astype(int)")
    if found.ndim != 1:
        raise ValueError(f"its {what} have {found.ndim} dimensions instead of one")
    if len(found) and not 0 <= found.min() <= found.max() <= most:
        raise ValueError(f"its {what} go from {found.min()} to {found.max()}. Use 0 to {most}")
    return torch.from_numpy(found.astype(np.int64))

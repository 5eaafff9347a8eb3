"""Objects as lists of Gaussians on disk: .npz for numpy, .json for everything else.

An .npz has `gaussians`, how many there are, `labels` if there are any, and of each object
`NAME.rows`, `NAME.ids` and, if known, `NAME.shares`. JSON has the same under `objects`.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.files import atomic_path, read_bytes, reason
from stylesplat.io.json_files import strict_json
from stylesplat.io.npy import DAMAGED, WHOLE, read_member
from stylesplat.io.row_labels import MAX_FILE, read_row_labels
from stylesplat.scene.labels import MAX_ID
from stylesplat.scene.scene import ListedObject, ListedObjects, is_id, name_fault

SUFFIXES = (".npz", ".json")
SIDECAR = ".objects.npz"  # what follows the name of a splat's file
ROWS, SHARES, IDS, COUNT, LABELS = ".rows", ".shares", ".ids", "gaussians", "labels"
MOST = 2**31  # Gaussians
NUMBERS = WHOLE + "bf"  # kinds of numpy's types

Id = Annotated[int, Meta(ge=0, le=MAX_ID)]
Natural = Annotated[int, Meta(ge=0, le=MOST)]
Share = Annotated[float, Meta(ge=0, le=1)]


class _Object(msgspec.Struct):
    rows: list[Natural]
    shares: list[Share] | None = None
    ids: list[Id] = []


class _Objects(msgspec.Struct):
    gaussians: Natural
    objects: dict[str, _Object]
    labels: list[Id] | None = None


def write_objects(listed: ListedObjects, path: Path | str) -> None:
    """Write objects, in the format that the file's suffix names.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    path = Path(path)
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".json":
            temporary.write_text(strict_json(_plain(listed)), encoding="utf-8")
        else:
            np.savez_compressed(temporary, allow_pickle=False, **_arrays(listed))


def read_objects(path: Path | str, count: int) -> ListedObjects:
    """Read objects, or labels alone as `read_row_labels` reads them.

    Args:
        path: The file.
        count: How many Gaussians there are.

    Raises:
        StyleSplatError: If the file is missing, damaged or of another kind, or of another number
            of Gaussians.
    """
    path = Path(path)
    listed = objects_in(path, count)
    return listed or ListedObjects(count, labels=read_row_labels(path, count))


def objects_in(path: Path, count: int) -> ListedObjects | None:
    """What `write_objects` wrote; None if it is another file.

    Raises:
        StyleSplatError: If it is damaged, or of another number of Gaussians.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        return None
    try:
        listed = _read_json(path) if suffix == ".json" else _read_npz(path, count)
        return listed and _checked(listed, count)
    except DAMAGED as error:
        raise cannot_list(path, reason(error)) from error


def _read_json(path: Path) -> ListedObjects | None:
    content = read_bytes(path, most=MAX_FILE).strip()
    if content.startswith(b"[") or b'"objects"' not in content:
        return None
    found = msgspec.json.decode(content, type=_Objects)
    objects = {
        name: _listed(
            name,
            torch.tensor(each.rows, dtype=torch.int64),
            None if each.shares is None else torch.tensor(each.shares),
            each.ids,
        )
        for name, each in found.objects.items()
    }
    labels = None if found.labels is None else torch.tensor(found.labels, dtype=torch.int64)
    return ListedObjects(found.gaussians, objects, labels)


def _read_npz(path: Path, count: int) -> ListedObjects | None:
    read_bytes(path, most=MAX_FILE, first=1)
    with zipfile.ZipFile(path) as archive:
        names = {name.removesuffix(".npy"): name for name in archive.namelist()}
        if COUNT not in names:
            return None

        def array(key: str) -> Tensor:
            found = read_member(archive, names[key], at_most(max(count, 1)), kinds=NUMBERS)
            return torch.from_numpy(found.astype(np.float32 if found.dtype.kind == "f" else int))

        objects = dict[str, ListedObject]()
        for key in names:
            if not key.endswith(ROWS):
                continue
            name = key.removesuffix(ROWS)
            shares = array(name + SHARES) if name + SHARES in names else None
            ids = array(name + IDS).tolist() if name + IDS in names else []
            objects[name] = _listed(name, array(key), shares, ids)
        labels = array(LABELS) if LABELS in names else None
        return ListedObjects(int(array(COUNT)), objects, labels)


def _listed(name: str, rows: Tensor, shares: Tensor | None, ids: list[int]) -> ListedObject:
    """An object, if there is a share for each row; a ValueError else."""
    if shares is not None and (len(shares) != len(rows) or not _within(shares, 1)):
        raise ValueError(f"the shares of {brief(name)!r} are not one from 0 to 1 for each row")
    return ListedObject(rows, shares, tuple(ids))


def _checked(listed: ListedObjects, count: int) -> ListedObjects:
    """The same, if all rows are there; a ValueError else."""
    if listed.count != count or (listed.labels is not None and len(listed.labels) != count):
        raise ValueError(f"it is about {listed.count:,} Gaussians, there are {count:,}")
    if listed.labels is not None and not _within(listed.labels, MAX_ID):
        raise ValueError(f"its labels are not all from 0 to {MAX_ID}")
    for name, each in listed.objects.items():
        fault = None if is_id(name) else name_fault(name)
        if fault:
            raise ValueError(f"no object is called {brief(name)!r}, for {fault}")
        if not len(each.rows) or not _within(each.rows, count - 1):
            raise ValueError(f"the rows of {brief(name)!r} are not all among {count:,} Gaussians")
        if not all(isinstance(id, int) and 0 <= id <= MAX_ID for id in each.ids):
            raise ValueError(f"the label ids of {brief(name)!r} are not from 0 to {MAX_ID}")
    return listed


def _within(values: Tensor, most: int) -> bool:
    return bool(((values >= 0) & (values <= most)).all())


def _plain(listed: ListedObjects) -> dict[str, Any]:
    objects = {
        name: {"ids": each.ids, "rows": each.rows.tolist()}
        | ({} if each.shares is None else {"shares": [round(s, 4) for s in each.shares.tolist()]})
        for name, each in listed.objects.items()
    }
    labels = {} if listed.labels is None else {LABELS: listed.labels.tolist()}
    return {COUNT: listed.count, "objects": objects, **labels}


def _arrays(listed: ListedObjects) -> dict[str, np.ndarray]:
    arrays = {COUNT: np.array(listed.count)}
    if listed.labels is not None:
        arrays[LABELS] = listed.labels.to(torch.int32).numpy()
    for name, each in listed.objects.items():
        arrays[name + ROWS] = each.rows.to(torch.int32).numpy()
        arrays[name + IDS] = np.array(each.ids, np.int32)
        if each.shares is not None:
            arrays[name + SHARES] = each.shares.float().numpy()
    return arrays


def at_most(count: int) -> Callable[[tuple[int, ...]], None]:
    """A check that arrays have so many numbers at most, in one line."""

    def check(shape: tuple[int, ...]) -> None:
        if len(shape) > 1 or any(not 0 <= size <= count for size in shape):
            raise ValueError(f"an array in it is of {shape}, not of {count:,} numbers at most")

    return check


def cannot_list(path: Path, fault: str) -> StyleSplatError:
    """What to say of a file of Gaussians that cannot be read."""
    return StyleSplatError(f"Cannot read Gaussians from {path}: {fault}.")

"""Which Gaussians are meant, on disk: objects, a label each, rows, masks.

`write_objects` makes .npz for numpy and .json for everything else. An .npz has `gaussians` (their
number), `labels` if there are any, and for each object `NAME.rows`, `NAME.ids` and, if known,
`NAME.shares`; JSON has the same under `objects`. Files of other programs are read as a label for
each Gaussian (`read_objects`) or as a selection (`read_rows`). Nothing is unpickled, and the sizes
that a header claims are checked before memory is allocated for them.
"""

import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Shaped
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief, some
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes, reason
from stylesplat.io.json_files import strict_json
from stylesplat.io.ply import read_ply_table
from stylesplat.scene.labels import MAX_ID
from stylesplat.scene.scene import ListedObject, ListedObjects, is_id, name_fault

SUFFIXES = (".npz", ".json")  # of `write_objects`
SIDECAR = ".objects.npz"  # follows the name of a splat's file
ROWS, SHARES, IDS, COUNT, LABELS = ".rows", ".shares", ".ids", "gaussians", "labels"
LABEL_NAMES = ("labels", "label", "object_ids", "object_id", "ids", "id")  # of arrays and columns
STATE = "state"  # SuperSplat's column in a .ply, whose first bit means selected
ROW_NAMES = (STATE, "rows", "mask")
READABLE = (".npy", ".npz", ".json", ".ply")
MAX_FILE = 2**30  # bytes: a hundred million labels
MAX_HEADER = 2**16  # bytes of the header of an array
MAX_ITEM = 16  # bytes of a number
# What damaged arrays, and archives of them, raise
DAMAGED = (
    *(ValueError, EOFError, OSError, RuntimeError, KeyError, TypeError, SyntaxError),
    *(OverflowError, MemoryError, zipfile.BadZipFile, zlib.error, tokenize.TokenError),
)

Array = Shaped[np.ndarray, "..."]
Id = Annotated[int, Meta(ge=0, le=MAX_ID)]
Natural = Annotated[int, Meta(ge=0, le=2**31)]
Share = Annotated[float, Meta(ge=0, le=1)]


class _Object(msgspec.Struct):
    rows: list[Natural]
    shares: list[Share] | None = None
    ids: list[Id] = []


class _Content(msgspec.Struct):
    """A JSON file: that of `write_objects`, or one with labels or rows alone."""

    gaussians: Natural | None = None
    objects: dict[str, _Object] | None = None
    labels: list[int] | None = None
    rows: list[Natural] | None = None


def write_objects(listed: ListedObjects, path: Path | str) -> None:
    """Write objects, in the format that the file's suffix names."""
    path = Path(path)
    with atomic_path(path) as draft:
        if path.suffix.lower() == ".json":
            draft.write_text(strict_json(_json_content(listed)), encoding="utf-8")
        else:
            np.savez_compressed(draft, allow_pickle=False, **_arrays(listed))


def read_objects(path: Path | str, count: int) -> ListedObjects:
    """Read the objects of `count` Gaussians: a file of `write_objects`, or a label for each.

    Labels are integers from 0 to 16777215: a .npy, a JSON list or the list `labels` of a JSON
    object, or the array of an .npz or column of a .ply that is called `labels`, `label`,
    `object_id` or `id`.
    """
    path = Path(path)
    with _errors_of(path):
        found = _read(path, count, LABEL_NAMES)
        if isinstance(found, ListedObjects):
            return found
        if found.size != count:
            has = " x ".join(f"{size:,}" for size in found.shape) or "1"
            raise ValueError(
                f"it has {has} labels, but there are {count:,} Gaussians. Give one for each, in "
                "the splat's order"
            )
        if found.dtype.kind == "f" and (np.mod(found, 1) == 0).all():  # PLY has them so
            found = found.astype(np.int64)
        if found.dtype.kind not in "iu":
            raise ValueError(f"it holds {found.dtype}, not integers. Save it with .astype(int)")
        low, high = int(found.min()), int(found.max())
        if low < 0 or high > MAX_ID:
            raise ValueError(
                f"its labels go from {low} to {high}. Use 0 for what is no object, and up to "
                f"{MAX_ID}"
            )
        return ListedObjects(count, labels=torch.from_numpy(found.reshape(count).astype(np.int64)))


def read_rows(path: Path | str, count: int, name: str) -> Bool[Tensor, " N"]:
    """Read a selection of `count` Gaussians as a mask.

    Takes a file of `write_objects`, of which the object `name` or the only one is read; row numbers
    or a mask in .npy, .npz or .json; or a .ply with SuperSplat's column `state`.
    """
    path = Path(path)
    with _errors_of(path):
        found = _read(path, count, ROW_NAMES)
        if isinstance(found, ListedObjects):
            objects = [*found.objects]
            key = name if name in objects or len(objects) != 1 else objects[0]
            if key not in objects:
                fault = f"it has no object {brief(name)!r}, but {some(objects) or 'none'}"
                raise ValueError(f"{fault}. Give the object one of these names")
            found = found.objects[key].rows.numpy()
        elif path.suffix.lower() == ".ply":
            found = (found.astype(np.int64) & 1).astype(bool)
        if found.dtype.kind == "b":
            if found.shape != (count,):
                raise ValueError(f"it is a mask of {found.size:,} Gaussians, there are {count:,}")
            found = found.nonzero()[0]
        if found.ndim != 1 or found.size > count:
            raise ValueError(f"it holds {found.shape}, not a list of at most {count:,} rows")
        if not len(found):
            raise ValueError("it names no Gaussian")
        if found.dtype.kind not in "iu":
            raise ValueError(f"it holds {found.dtype}, not integers. Save it with .astype(int)")
        low, high = int(found.min()), int(found.max())
        if low < 0 or high >= count:
            raise ValueError(f"it names rows {low} to {high}, there are 0 to {count - 1}")
    mask = torch.zeros(count, dtype=torch.bool)
    mask[torch.from_numpy(found.astype(np.int64))] = True
    return mask


def _read(path: Path, count: int, names: Sequence[str]) -> ListedObjects | Array:
    """What `write_objects` wrote, or the array or column that has one of these names."""
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise ValueError(f"unknown suffix {path.suffix!r}. Save {', '.join(READABLE)}")
    if suffix == ".ply":
        table = read_ply_table(path)
        return table[_choice(table.dtype.names or (), names)]
    if suffix == ".json":
        return _read_json(read_bytes(path, most=MAX_FILE).strip(), count)
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
    raise ValueError(f"it holds {some([*found])}, but nothing called {' or '.join(names[:3])}")


def _read_json(content: bytes, count: int) -> ListedObjects | Array:
    if content.startswith(b"["):
        return np.array(msgspec.json.decode(content, type=list[int]), np.int64)
    found = msgspec.json.decode(content, type=_Content)
    if found.objects is None:
        numbers = found.rows if found.labels is None else found.labels
        if numbers is None:
            raise ValueError("it has neither `objects` nor `labels` nor `rows`")
        return np.array(numbers, np.int64)
    objects = {
        name: _object(
            name,
            torch.tensor(each.rows, dtype=torch.int64),
            None if each.shares is None else torch.tensor(each.shares),
            each.ids,
        )
        for name, each in found.objects.items()
    }
    labels = None if found.labels is None else torch.tensor(found.labels, dtype=torch.int64)
    gaussians = count if found.gaussians is None else found.gaussians
    return _checked(ListedObjects(gaussians, objects, labels), count)


def _read_npz(archive: Any, count: int, names: Sequence[str]) -> ListedObjects | Array:
    def array(key: str) -> Array:
        size = archive.zip.getinfo(f"{key}.npy").file_size
        if size > MAX_HEADER + MAX_ITEM * max(count, 1):
            raise ValueError(f"{brief(key)!r} has {size:,} bytes, too many for {count:,} Gaussians")
        return archive[key]

    def numbers(key: str) -> Tensor:
        found = array(key)
        return torch.from_numpy(found.astype(np.float32 if found.dtype.kind == "f" else np.int64))

    if COUNT not in archive.files:
        files = archive.files
        return array(files[0] if len(files) == 1 else _choice(files, names))
    objects = dict[str, ListedObject]()
    for key in archive.files:
        if key.endswith(ROWS):
            name = key.removesuffix(ROWS)
            shares = numbers(name + SHARES) if name + SHARES in archive.files else None
            ids = numbers(name + IDS).tolist() if name + IDS in archive.files else []
            objects[name] = _object(name, numbers(key), shares, ids)
    labels = numbers(LABELS) if LABELS in archive.files else None
    return _checked(ListedObjects(int(numbers(COUNT)), objects, labels), count)


def _object(name: str, rows: Tensor, shares: Tensor | None, ids: Sequence[Any]) -> ListedObject:
    if shares is not None and (shares.shape != rows.shape or not _within(shares, 1)):
        raise ValueError(f"the shares of {brief(name)!r} are not one from 0 to 1 for each row")
    return ListedObject(rows, shares, tuple(ids))


def _checked(listed: ListedObjects, count: int) -> ListedObjects:
    """The same; a ValueError for objects that are not of `count` Gaussians."""
    if listed.count != count or (listed.labels is not None and len(listed.labels) != count):
        raise ValueError(f"it is about {listed.count:,} Gaussians, there are {count:,}")
    if listed.labels is not None and not _within(listed.labels, MAX_ID):
        raise ValueError(f"its labels are not all from 0 to {MAX_ID}")
    for name, each in listed.objects.items():
        fault = None if is_id(name) else name_fault(name)
        if fault:
            raise ValueError(f"no object is called {brief(name)!r}, for {fault}")
        if not each.rows.numel() or not _within(each.rows, count - 1):
            raise ValueError(f"the rows of {brief(name)!r} are not all among {count:,} Gaussians")
        if not all(isinstance(id, int) and 0 <= id <= MAX_ID for id in each.ids):
            raise ValueError(f"the label ids of {brief(name)!r} are not from 0 to {MAX_ID}")
    return listed


def _within(values: Tensor, most: int) -> bool:
    return values.ndim == 1 and bool(((values >= 0) & (values <= most)).all())


def _json_content(listed: ListedObjects) -> dict[str, Any]:
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


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """Turn what damaged files raise into a StyleSplatError that names the file."""
    try:
        yield
    except DAMAGED as error:
        raise StyleSplatError(f"Cannot read Gaussians from {path}: {reason(error)}.") from error

"""Which Gaussians are meant, on disk: objects, a label each, rows, masks.

`write_objects` makes .npz for numpy and .json for everything else. An .npz has `gaussians` (their
number), `labels` if there are any, and for each object `NAME.rows`, `NAME.ids` and, if known,
`NAME.shares`; JSON has the same under `objects`. Files of other programs are read as a label for
each Gaussian (`read_row_labels`) or as a selection (`read_rows`). Nothing is unpickled, and the
counts of a header are checked before memory is allocated for them.
"""

import io
import math
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BufferedIOBase
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Int, Shaped
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
MAX_FILE = 2**30  # bytes: a hundred million labels
INTEGERS, MASKS, NUMBERS = "iu", "iub", "iubf"  # kinds of numpy's types
# What damaged arrays, and archives of them, raise
DAMAGED = (
    *(ValueError, EOFError, OSError, RuntimeError, KeyError, TypeError, SyntaxError),
    *(OverflowError, MemoryError, zipfile.BadZipFile, zlib.error, tokenize.TokenError),
)

Shape = tuple[int, ...]
CheckShape = Callable[[Shape], None]
Array = Shaped[np.ndarray, "..."]
Id = Annotated[int, Meta(ge=0, le=MAX_ID)]
Natural = Annotated[int, Meta(ge=0, le=2**31)]
Share = Annotated[float, Meta(ge=0, le=1)]


class _Object(msgspec.Struct):
    rows: list[Natural]
    shares: list[Share] | None = None
    ids: list[Id] = []


class _Objects(msgspec.Struct):
    gaussians: Natural
    objects: dict[str, _Object]
    labels: list[Id] | None = None


class _Labels(msgspec.Struct):
    labels: list[int]


class _Rows(msgspec.Struct):
    rows: list[Natural]


def write_objects(listed: ListedObjects, path: Path | str) -> None:
    """Write objects, in the format that the file's suffix names."""
    path = Path(path)
    with atomic_path(path) as draft:
        if path.suffix.lower() == ".json":
            draft.write_text(strict_json(_json_content(listed)), encoding="utf-8")
        else:
            np.savez_compressed(draft, allow_pickle=False, **_arrays(listed))


def read_objects(path: Path | str, count: int) -> ListedObjects:
    """Read the objects of `count` Gaussians, or their labels alone as `read_row_labels` does."""
    path = Path(path)
    listed = _read_listed(path, count)
    return listed or ListedObjects(count, labels=read_row_labels(path, count))


def read_row_labels(path: Path | str, count: int) -> Int[Tensor, " N"]:
    """Read one label per Gaussian: a .npy, .npz or .json file, or a column of a .ply.

    Of several arrays of an .npz or columns of a .ply, `labels`, `label`, `object_id` or `id` is
    read. JSON is a list, or has it under `labels`. Labels are integers from 0 to 16777215.
    """
    path = Path(path)

    def check(shape: Shape) -> None:
        if math.prod(shape) != count or {*shape} - {1, count}:
            has = " x ".join(f"{size:,}" for size in shape) or "1"
            raise ValueError(
                f"it has {has} labels, but there are {count:,} Gaussians. Give one for each, in "
                "the splat's order"
            )

    def read_npz() -> Array:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path, most=MAX_FILE))) as archive:
            names = {Path(n).stem: n for n in archive.namelist() if n.endswith(".npy")}
            name = next(iter(names)) if len(names) == 1 else _label_name([*names], "array")
            return _read_member(archive, names[name], check)

    readers: dict[str, Callable[[], Array]] = {
        ".npy": lambda: _read_npy(io.BytesIO(read_bytes(path, most=MAX_FILE)), check),
        ".npz": read_npz,
        ".json": lambda: np.array(_json_numbers(path, list[int], _Labels), np.int64),
        ".ply": lambda: _label_column(path),
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise StyleSplatError(
            f"Cannot read labels from {path}: unknown suffix {path.suffix!r}. Save one integer "
            f"per Gaussian as {', '.join(readers)}."
        )
    with _errors_of(path, "labels"):
        values = reader()
        check(values.shape)
        low, high = int(values.min()), int(values.max())
        if low < 0 or high > MAX_ID:
            raise ValueError(
                f"its labels go from {low} to {high}. Use 0 for what is no object, and up to "
                f"{MAX_ID}"
            )
    return torch.from_numpy(values.reshape(count).astype(np.int64))


def read_rows(path: Path | str, count: int, name: str) -> Bool[Tensor, " N"]:
    """Read a selection of `count` Gaussians as a mask.

    Takes a file of `write_objects`, of which the object `name` or the only one is read; row numbers
    or a mask in .npy, .npz or .json; or a .ply with SuperSplat's column `state`.
    """
    path = Path(path)
    listed = _read_listed(path, count)
    with _errors_of(path):
        rows = _selection(path, count) if listed is None else _object_rows(listed, name)
        if rows.dtype.kind == "b":
            if len(rows) != count:
                raise ValueError(f"it is a mask of {len(rows):,}, there are {count:,}")
            rows = rows.nonzero()[0]
        if not len(rows):
            raise ValueError("it names no Gaussian")
        if rows.min() < 0 or rows.max() >= count:
            raise ValueError(
                f"it names rows {rows.min()} to {rows.max()}, there are 0 to {count - 1}"
            )
    mask = torch.zeros(count, dtype=torch.bool)
    mask[torch.from_numpy(rows.astype(np.int64))] = True
    return mask


def _read_listed(path: Path, count: int) -> ListedObjects | None:
    """What `write_objects` wrote; None for another file."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        return None
    with _errors_of(path):
        listed = _read_json(path) if suffix == ".json" else _read_npz(path, count)
        if listed is not None:
            _check(listed, count)
        return listed


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
            found = _read_member(archive, names[key], _at_most(max(count, 1)), kinds=NUMBERS)
            return torch.from_numpy(found.astype(np.float32 if found.dtype.kind == "f" else int))

        objects = dict[str, ListedObject]()
        for key in names:
            if key.endswith(ROWS):
                name = key.removesuffix(ROWS)
                shares = array(name + SHARES) if name + SHARES in names else None
                ids = array(name + IDS).tolist() if name + IDS in names else []
                objects[name] = _listed(name, array(key), shares, ids)
        labels = array(LABELS) if LABELS in names else None
        return ListedObjects(int(array(COUNT)), objects, labels)


def _listed(name: str, rows: Tensor, shares: Tensor | None, ids: list[int]) -> ListedObject:
    if shares is not None and (len(shares) != len(rows) or not _within(shares, 1)):
        raise ValueError(f"the shares of {brief(name)!r} are not one from 0 to 1 for each row")
    return ListedObject(rows, shares, tuple(ids))


def _check(listed: ListedObjects, count: int) -> None:
    """Raise a ValueError for objects that are not of `count` Gaussians."""
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


def _within(values: Tensor, most: int) -> bool:
    return bool(((values >= 0) & (values <= most)).all())


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


def _object_rows(listed: ListedObjects, name: str) -> Int[np.ndarray, " M"]:
    objects = [*listed.objects]
    key = name if name in objects or len(objects) != 1 else objects[0]
    if key not in objects:
        fault = f"it has no object {brief(name)!r}, but {some(objects) or 'none'}"
        raise ValueError(f"{fault}. Give the object one of these names")
    return listed.objects[key].rows.numpy()


def _selection(path: Path, count: int) -> Array:
    """Row numbers or a mask."""

    def read_npy() -> Array:
        read_bytes(path, most=MAX_FILE, first=1)
        with path.open("rb") as stream:
            return _read_npy(stream, _at_most(count), kinds=MASKS)

    def read_npz() -> Array:
        read_bytes(path, most=MAX_FILE, first=1)
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            if len(names) != 1:
                raise ValueError(f"it holds {some(names)}, of which one could be meant")
            return _read_member(archive, names[0], _at_most(count), kinds=MASKS)

    readers: dict[str, Callable[[], Array]] = {
        ".npy": read_npy,
        ".npz": read_npz,
        ".json": lambda: np.array(_json_numbers(path, list[Natural], _Rows), np.int64),
        ".ply": lambda: _state_column(path, count),
    }
    if path.suffix.lower() not in readers:
        raise ValueError(f"unknown suffix {path.suffix!r}. Save {', '.join(readers)}")
    return readers[path.suffix.lower()]()


def _json_numbers(path: Path, plain: Any, named: type[_Labels] | type[_Rows]) -> list[int]:
    """A list, or an object that holds it."""
    content = read_bytes(path, most=MAX_FILE).strip()
    if content.startswith(b"["):
        return msgspec.json.decode(content, type=plain)
    found = msgspec.json.decode(content, type=named)
    return found.labels if isinstance(found, _Labels) else found.rows


def _label_column(path: Path) -> Array:
    table = read_ply_table(path)
    column = table[_label_name([*(table.dtype.names or ())], "column")]
    if column.dtype.kind not in INTEGERS and not (np.mod(column, 1) == 0).all():
        raise ValueError("its labels are not whole numbers")
    return column


def _state_column(path: Path, count: int) -> Bool[np.ndarray, " N"]:
    """What was selected in SuperSplat when it wrote a .ply."""
    table = read_ply_table(path)
    if STATE not in (table.dtype.names or ()):
        raise ValueError(f"it has no column {STATE!r}, in which SuperSplat has what is selected")
    if len(table) != count:
        raise ValueError(f"it has {len(table):,} Gaussians, there are {count:,}")
    return (table[STATE].astype(np.int64) & 1).astype(bool)


def _label_name(names: list[str], kind: str) -> str:
    """Which of some arrays or columns holds the labels."""
    found = next((name for name in LABEL_NAMES if name in names), None)
    if found is None:
        labels, label, _, object_id, *_ = LABEL_NAMES
        raise ValueError(f"no {kind} of it is called {labels}, {label} or {object_id}")
    return found


def _read_npy(stream: BufferedIOBase, check: CheckShape, *, kinds: str = INTEGERS) -> Array:
    """A one-dimensional array of a .npy; `check` raises a ValueError for unexpected shapes."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError("it is of a later version of numpy's format. Save plain integers")
    first = version == (1, 0)
    read_header = (
        np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        raise ValueError("it holds pickled Python objects, which are never loaded. Save integers")
    if dtype.kind not in kinds:
        raise ValueError(f"it holds {dtype}, not integers. Save it with .astype(int)")
    check(shape)
    size = math.prod(shape) * dtype.itemsize
    content = stream.read(size + 1)
    if len(content) != size:
        raise ValueError("it is cut off, or holds more than its header says")
    return np.frombuffer(content, dtype)


def _read_member(
    archive: zipfile.ZipFile, name: str, check: CheckShape, *, kinds: str = INTEGERS
) -> Array:
    """An array of an .npz."""
    with archive.open(name) as stream:
        return _read_npy(cast("BufferedIOBase", stream), check, kinds=kinds)


def _at_most(count: int) -> CheckShape:
    def check(shape: Shape) -> None:
        if len(shape) > 1 or any(not 0 <= size <= count for size in shape):
            raise ValueError(f"an array in it is of {shape}, not of {count:,} numbers at most")

    return check


@contextmanager
def _errors_of(path: Path, what: str = "Gaussians") -> Iterator[None]:
    """Turn what damaged files raise into a StyleSplatError that names the file."""
    try:
        yield
    except DAMAGED as error:
        raise StyleSplatError(f"Cannot read {what} from {path}: {reason(error)}.") from error

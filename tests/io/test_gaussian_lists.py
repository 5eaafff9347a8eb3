"""Objects, labels and selections as lists of Gaussians."""

import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.gaussian_lists import read_objects, read_rows, write_objects
from stylesplat.io.ply import write_ply_rows
from stylesplat.scene.objects import ListedObject, ListedObjects

COUNT = 8
LABELS = [0, 3, 70_000, 0, 3, 0, 3, 0]
ROWS = [1, 4, 6]
LISTED = ListedObjects(
    COUNT,
    {
        "pot": ListedObject(torch.tensor(ROWS), torch.tensor([1.0, 0.5, 0.25]), (3,)),
        "ünïque name": ListedObject(torch.tensor([0])),
        "7": ListedObject(torch.tensor([2]), None, (7,)),
    },
    torch.tensor(LABELS),
)


def saved(path: Path, values: Any) -> Path:
    """Values in the format that the suffix names."""
    if path.suffix.lower() == ".npy":
        with path.open("wb") as file:
            np.save(file, values, allow_pickle=True)
    elif path.suffix == ".npz":
        np.savez(path, **values) if isinstance(values, dict) else np.savez(path, values)
    else:
        table = np.zeros(
            len(next(iter(values.values()))), [(n, v.dtype) for n, v in values.items()]
        )
        for name, column in values.items():
            table[name] = column
        write_ply_rows(path, len(table), table.dtype, [table])
    return path


@pytest.mark.parametrize("labels", [True, False])
def test_objects_come_back(labels: bool, tmp_path: Path):
    wanted = LISTED if labels else ListedObjects(COUNT, LISTED.objects)
    path = tmp_path / "a.npz"
    write_objects(wanted, path)
    found = read_objects(path, COUNT)
    assert [*found.objects] == [*wanted.objects] and found.count == COUNT
    assert found.objects["pot"].rows.tolist() == ROWS and found.objects["pot"].ids == (3,)
    shares = found.objects["pot"].shares
    assert shares is not None and shares.tolist() == [1.0, 0.5, 0.25]
    assert found.objects["ünïque name"].shares is None
    assert (None if found.labels is None else found.labels.tolist()) == (LABELS if labels else None)
    assert read_rows(path, COUNT, "pot").nonzero()[:, 0].tolist() == ROWS
    first = path.read_bytes()
    write_objects(wanted, path)
    assert path.read_bytes() == first
    with np.load(path) as arrays:
        assert arrays["pot.rows"].tolist() == ROWS and arrays["gaussians"] == COUNT


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.npy", np.array(LABELS, ">i4")),
        ("A.NPY", np.array(LABELS)[:, None]),
        ("a.npz", {"scores": np.zeros(COUNT), "object_id": np.array(LABELS)}),
        ("a.ply", {"x": np.zeros(COUNT, "f4"), "object_id": np.array(LABELS, "f4")}),
    ],
)
def test_labels_alone(name: str, values: Any, tmp_path: Path):
    found = read_objects(saved(tmp_path / name, values), COUNT)
    assert found.labels is not None and found.labels.dtype == torch.int64
    assert found.labels.tolist() == LABELS and not found.objects


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.npy", np.array([6, 1, 4])),
        ("a.npy", np.isin(np.arange(COUNT), ROWS)),
        ("a.npz", np.array([1, 4, 6, 6], np.uint8)),
        ("a.npz", {"gaussians": COUNT, "other.rows": ROWS}),
        ("a.ply", {"x": np.zeros(COUNT, "f4"), "state": np.array([0, 1, 2, 0, 1, 4, 3, 0], "u1")}),
    ],
)
def test_rows_of_others(name: str, values: Any, tmp_path: Path):
    found = read_rows(saved(tmp_path / name, values), COUNT, "pot")
    assert found.nonzero()[:, 0].tolist() == ROWS


def test_another_order():
    found = LISTED.ordered(torch.tensor([6, 7, 4, 2, 3]))
    assert found.count == 5 and found.labels is not None
    assert found.labels.tolist() == [3, 0, 3, 70_000, 0]
    assert [*found.objects] == ["pot", "7"], "what has no Gaussians is dropped"
    assert found.objects["pot"].rows.tolist() == [0, 2]


def refused(path: Path, fault: str, *, rows: bool) -> None:
    with pytest.raises(StyleSplatError) as caught:
        read_rows(path, COUNT, "pot") if rows else read_objects(path, COUNT)
    line = str(caught.value)
    assert line.startswith("Cannot read ") and str(path) in line
    assert fault in line and line.isprintable()


@pytest.mark.parametrize(
    ("name", "values", "fault"),
    [
        ("a.npy", np.zeros(7, int), "it has 7 labels, but there are 8 Gaussians"),
        ("a.npy", np.zeros(8) + 0.5, "it holds float64, not integers"),
        ("a.npy", np.array([{}] * 8, object), "Python objects"),
        ("a.npy", np.arange(8) - 2, "its labels go from -2 to 5. Use 0"),
        ("a.npz", {"a": np.zeros(8, int), "b": np.zeros(8, int)}, "nothing called labels or"),
        ("a.pkl", {"x": np.zeros(8, "f4")}, "unknown suffix '.pkl'. Save .npy, .npz"),
        ("a.ply", {"x": np.zeros(8, "f4")}, "it holds x, but nothing called labels or label"),
    ],
)
def test_what_holds_no_labels(name: str, values: Any, fault: str, tmp_path: Path):
    refused(saved(tmp_path / name, values), fault, rows=False)


@pytest.mark.parametrize(
    ("name", "values", "fault"),
    [
        ("a.npy", np.array([1.5]), "float64, not integers"),
        ("a.npy", np.array([-1, 8]), "its rows go from -1 to 8. Use 0 to 7"),
        ("a.npy", np.zeros(3, bool), "a mask of 3 Gaussians, there are 8"),
        ("a.npy", np.zeros(8, bool), "it names no Gaussian"),
        ("a.npz", {"gaussians": 9, "pot.rows": [1]}, "about 9 Gaussians, there are 8"),
        ("a.npy", np.zeros(9, int), "it has 9 rows, there are 8"),
        ("a.npy", np.zeros((2, 2), int), "2 dimensions instead of one"),
        ("a.npz", {"gaussians": 8, "pot.rows": np.zeros(0, int)}, "'pot' has no rows"),
        ("a.npz", {"gaussians": 8}, "no object 'pot', but none"),
        ("a.npz", {"gaussians": 8, "pot.rows": [9]}, "its rows of 'pot' go from 9 to 9"),
        ("a.npz", {"gaussians": 8, "a=b.rows": [1]}, "no object is called"),
        ("a.npz", {"gaussians": 8, "a.rows": [1], "a.shares": [1, 1]}, "for each row"),
        ("lost.npy", None, "No such file"),
    ],
)
def test_what_lists_no_rows(name: str, values: Any, fault: str, tmp_path: Path):
    path = tmp_path / name
    refused(path if values is None else saved(path, values), fault, rows=True)


def header(shape: str, kind: str = "<i8") -> bytes:
    """Of an .npy file."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    "content",
    [
        b"",
        pickle.dumps(LABELS),
        header("(8,)") + bytes(63),
        header("(99999999999999,)") + bytes(64),
        header("(8,)", "|O") + pickle.dumps(LABELS),
        header("(" * 300) + bytes(64),
    ],
)
def test_damaged_arrays(content: bytes, tmp_path: Path):
    (tmp_path / "a.npy").write_bytes(content)
    refused(tmp_path / "a.npy", "a.npy", rows=False)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("labels.npy", content)
    refused(tmp_path / "a.npz", "a.npz", rows=False)


def test_an_archive_that_would_unpack_to_too_much(tmp_path: Path):
    np.savez_compressed(tmp_path / "a.npz", labels=np.zeros(10**6))
    refused(tmp_path / "a.npz", "bytes, too many for 8 Gaussians", rows=False)

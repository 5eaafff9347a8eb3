"""One label per Gaussian, as other programs keep them beside a splat."""

import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.gaussian_lists import read_row_labels
from stylesplat.io.ply import write_ply_table

LABELS = [0, 3, 3, 70000, 0]
COUNT = len(LABELS)


def write(path: Path, values: Any) -> Path:
    """Values in the format that the suffix names."""
    if path.suffix == ".npy":
        np.save(path, values, allow_pickle=True)
    elif path.suffix == ".npz":
        np.savez(path, **values) if isinstance(values, dict) else np.savez(path, values)
    else:
        path.write_text(json.dumps(values), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.npy", np.array(LABELS)),
        ("a.npy", np.array(LABELS, np.uint32)),
        ("a.npy", np.array(LABELS, ">i4")),
        ("a.npy", np.array(LABELS)[:, None]),
        ("A.NPY", np.array(LABELS)),
        ("a.npz", np.array(LABELS)),
        ("a.npz", {"points": np.zeros((5, 3)), "labels": np.array(LABELS)}),
        ("a.npz", {"scores": np.zeros(5), "object_id": np.array(LABELS)}),
        ("a.json", LABELS),
        ("a.json", {"version": 1, "labels": LABELS}),
    ],
)
def test_labels_come_back(name: str, values: Any, tmp_path: Path):
    path = tmp_path / name
    if path.suffix.isupper():
        write(tmp_path / "a.npy", values).rename(path)
    else:
        write(path, values)
    found = read_row_labels(path, COUNT)
    assert found.dtype == torch.int64 and found.tolist() == LABELS


@pytest.mark.parametrize("kind", ["i4", "f4", "u1"])
def test_a_column_of_a_ply(kind: str, tmp_path: Path):
    labels = [0, 3, 3, 70, 0]
    table = np.zeros(COUNT, [("x", "f4"), ("object_id", "f4" if kind == "i4" else kind)])
    table["object_id"] = labels
    write_ply_table(table, tmp_path / "a.ply")
    assert read_row_labels(tmp_path / "a.ply", COUNT).tolist() == labels
    table["object_id"] = 1.5
    if kind == "f4":
        write_ply_table(table, tmp_path / "a.ply")
        with pytest.raises(StyleSplatError, match="not whole numbers"):
            read_row_labels(tmp_path / "a.ply", COUNT)


@pytest.mark.parametrize(
    ("name", "values", "fault"),
    [
        ("a.npy", np.array(LABELS[:-1]), "it has 4 labels, but there are 5 Gaussians. Give one"),
        ("a.npy", np.zeros((5, 2), int), "it has 5 x 2 labels"),
        ("a.npy", np.array(3), "it has 1 labels"),
        ("a.npy", np.array(LABELS) + 0.5, "it holds float64, not integers"),
        ("a.npy", np.array(LABELS, bool), "it holds bool, not integers"),
        ("a.npy", np.array(["a"] * 5), "it holds <U1, not integers"),
        ("a.npy", np.array([{}] * 5, object), "pickled Python objects, which are never loaded"),
        ("a.npy", np.array([0, 1, -1, 2, 3]), "its labels go from -1 to 3. Use 0"),
        ("a.npy", np.array([0, 2**24, 1, 2, 3]), "its labels go from 0 to 16777216"),
        ("a.npy", np.full(5, 2**64 - 1, np.uint64), "to 18446744073709551615"),
        ("a.npz", {"a": np.zeros(5, int), "b": np.zeros(5, int)}, "no array of it is called label"),
        ("a.npz", {"labels": np.array([{}] * 5, object)}, "pickled Python objects"),
        ("a.npz", np.zeros(9, int), "it has 9 labels"),
        ("a.json", [0, 1, 2.5, 3, 4], "Expected `int`, got `float` - at `$[2]`"),
        ("a.json", [0, 1, "2", 3, 4], "Expected `int`, got `str`"),
        ("a.json", [0, 1, None, 3, 4], "Expected `int`, got `null`"),
        ("a.json", [0, 1, [2], 3, 4], "Expected `int`, got `array`"),
        ("a.json", [0, 1, 10**30, 3, 4], "too large"),
        ("a.json", [0, 1, -3, 3, 4], "its labels go from -3 to 4"),
        ("a.json", [], "it has 0 labels"),
        ("a.json", {"ids": LABELS}, "missing required field `labels`"),
        ("a.json", 3, "Expected `object`, got `int`"),
        ("a.txt", LABELS, "unknown suffix '.txt'. Save one integer per Gaussian as .npy, .npz"),
        ("a.pkl", LABELS, "unknown suffix '.pkl'"),
    ],
)
def test_what_holds_no_labels_is_refused(name: str, values: Any, fault: str, tmp_path: Path):
    refuse(write(tmp_path / name, values), fault)


def refuse(path: Path, fault: str) -> None:
    with pytest.raises(StyleSplatError) as caught:
        read_row_labels(path, COUNT)
    line = str(caught.value)
    assert line.startswith("Cannot read ") and str(path) in line
    assert fault in line and line.isprintable()


def header(shape: str, kind: str = "<i8") -> bytes:
    """Of an .npy file."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        b"\x93NUMPY\x03\x00\x00\x00\x00\x00",
        pickle.dumps(LABELS),
        header("(5,)"),
        header("(5,)") + bytes(39),
        header("(5,)") + bytes(41),
        header("(-5,)") + bytes(40),
        header("(5, -1, -1)") + bytes(40),
        header("5") + bytes(40),
        header("(99999999999999,)") + bytes(40),
        header("(5,)", "|O") + pickle.dumps(LABELS),
        header("(5,)", "<i3") + bytes(40),
        header("(" * 300) + bytes(40),
        header("(5L,)")[:-3] + b"'",
    ],
)
def test_damaged_arrays_are_refused(content: bytes, tmp_path: Path):
    (tmp_path / "a.npy").write_bytes(content)
    refuse(tmp_path / "a.npy", "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("labels.npy", content)
    refuse(tmp_path / "a.npz", "a.npz")


def test_archives_that_are_none_or_hold_more_than_they_may(tmp_path: Path):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 and no more")
    refuse(tmp_path / "a.npz", "a.npz")
    stream = io.BytesIO()
    np.save(stream, np.zeros(COUNT, int))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("labels.npy", stream.getvalue() + bytes(10**8))
    assert (tmp_path / "a.npz").stat().st_size < 10**6
    refuse(tmp_path / "a.npz", "holds more than its header says")


def test_files_that_are_not_there_or_no_files(tmp_path: Path):
    refuse(tmp_path / "lost.npy", "No such file")
    (tmp_path / "folder.npy").mkdir()
    refuse(tmp_path / "folder.npy", "folder.npy")
    (tmp_path / "a.ply").write_bytes(b"ply\nno header")
    refuse(tmp_path / "a.ply", "it is not a PLY file")
    write_ply_table(np.zeros(COUNT, [("x", "f4")]), tmp_path / "a.ply")
    refuse(tmp_path / "a.ply", "no column of it is called labels, label or object_id")
    write_ply_table(np.zeros(2, [("label", "u1")]), tmp_path / "a.ply")
    refuse(tmp_path / "a.ply", "it has 2 labels")

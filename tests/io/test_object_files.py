"""Objects and selections as lists of Gaussians."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.gaussian_lists import read_objects, read_rows, write_objects
from stylesplat.io.ply import write_ply_table
from stylesplat.scene.scene import ListedObject, ListedObjects

COUNT = 8
POT = ListedObject(torch.tensor([1, 4, 6]), torch.tensor([1.0, 0.5, 0.25]), (3,))
LISTED = ListedObjects(
    COUNT,
    {
        "pot": POT,
        "ünïque name": ListedObject(torch.tensor([0])),
        "7": ListedObject(torch.tensor([2]), None, (7,)),
    },
    torch.tensor([0, 3, 7, 0, 3, 0, 3, 0]),
)


@pytest.mark.parametrize("suffix", [".npz", ".json"])
@pytest.mark.parametrize("labels", [True, False])
def test_objects_come_back(suffix: str, labels: bool, tmp_path: Path):
    wanted = LISTED if labels else ListedObjects(COUNT, LISTED.objects)
    path = tmp_path / f"a{suffix}"
    write_objects(wanted, path)
    found = read_objects(path, COUNT)
    assert [*found.objects] == [*wanted.objects] and found.count == COUNT
    assert found.objects["pot"].rows.tolist() == [1, 4, 6]
    assert found.objects["pot"].ids == (3,)
    shares = found.objects["pot"].shares
    assert shares is not None and shares.tolist() == [1.0, 0.5, 0.25]
    assert found.objects["ünïque name"].shares is None
    assert (found.labels is None) != labels
    if found.labels is not None:
        assert found.labels.tolist() == [0, 3, 7, 0, 3, 0, 3, 0]
    assert read_rows(path, COUNT, "pot").nonzero()[:, 0].tolist() == [1, 4, 6]
    first = path.read_bytes()
    write_objects(wanted, path)
    assert path.read_bytes() == first


def test_numpy_reads_it(tmp_path: Path):
    write_objects(LISTED, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as found:
        assert found["pot.rows"].tolist() == [1, 4, 6] and found["gaussians"] == COUNT
        assert found["labels"].tolist() == [0, 3, 7, 0, 3, 0, 3, 0]


def test_labels_alone_are_read_too(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.arange(COUNT))
    (tmp_path / "a.json").write_text(str([*range(COUNT)]))
    np.savez(tmp_path / "a.npz", labels=np.arange(COUNT))
    for suffix in ("npy", "json", "npz"):
        found = read_objects(tmp_path / f"a.{suffix}", COUNT)
        assert found.labels is not None and found.labels.tolist() == [*range(COUNT)]
        assert not found.objects


def test_another_order():
    found = LISTED.ordered(torch.tensor([6, 7, 4, 2, 3]))
    assert (
        found.count == 5 and found.labels is not None and found.labels.tolist() == [3, 0, 3, 7, 0]
    )
    assert [*found.objects] == ["pot", "7"], "what has no Gaussians is dropped"
    pot = found.objects["pot"]
    assert pot.rows.tolist() == [0, 2]
    assert pot.shares is not None and pot.shares.tolist() == [0.25, 0.5]
    assert found.shares().tolist() == [0.25, 0, 0.5, 0, 0]
    assert ListedObjects(COUNT, LISTED.objects).numbered().tolist() == [2, 1, 3, 0, 1, 0, 1, 0]


def saved(path: Path, values: Any) -> Path:
    if path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".npz":
        np.savez(path, values)
    elif path.suffix == ".ply":
        table = np.zeros(len(values), [("x", "<f4"), ("state", "u1")])
        table["state"] = values
        write_ply_table(table, path)
    else:
        path.write_text(json.dumps(values), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.npy", np.array([6, 1, 4])),
        ("a.npy", np.isin(np.arange(COUNT), [1, 4, 6])),
        ("a.npz", np.array([1, 4, 6, 6], np.uint8)),
        ("a.json", [1, 6, 4]),
        ("a.json", {"rows": [1, 6, 4]}),
        ("a.json", {"gaussians": COUNT, "objects": {"other": {"rows": [1, 4, 6]}}}),
        ("a.ply", [0, 1, 2, 0, 1, 4, 3, 0]),
    ],
)
def test_rows_of_others(name: str, values: Any, tmp_path: Path):
    found = read_rows(saved(tmp_path / name, values), COUNT, "pot")
    assert found.nonzero()[:, 0].tolist() == [1, 4, 6]


@pytest.mark.parametrize(
    ("name", "values", "fault"),
    [
        ("a.npy", np.array([1.5]), "float64, not integers"),
        ("a.npy", np.array([[1, 2]]), "not of 8 numbers at most"),
        ("a.npy", np.arange(9), "not of 8 numbers at most"),
        ("a.npy", np.array([8]), "rows 8 to 8, there are 0 to 7"),
        ("a.npy", np.array([-1]), "rows -1 to -1"),
        ("a.npy", np.zeros(3, bool), "a mask of 3, there are 8"),
        ("a.npy", np.zeros(8, bool), "it names no Gaussian"),
        ("a.json", [], "it names no Gaussian"),
        ("a.json", ["a"], "Expected `int`"),
        ("a.json", {"gaussians": 9, "objects": {}}, "about 9 Gaussians, there are 8"),
        ("a.json", {"gaussians": 8, "objects": {}}, "no object 'pot', but none"),
        (
            "a.json",
            {"gaussians": 8, "objects": {"a": {"rows": [1]}, "b": {"rows": [2]}}},
            "no object 'pot', but a, b",
        ),
        ("a.json", {"gaussians": 8, "objects": {"pot": {"rows": [9]}}}, "not all among 8"),
        ("a.json", {"gaussians": 8, "objects": {"a/b": {"rows": [1]}}}, "no object is called"),
        (
            "a.json",
            {"gaussians": 8, "objects": {"pot": {"rows": [1], "shares": [1, 1]}}},
            "not one from 0 to 1 for each row",
        ),
        ("a.ply", [0, 1], "it has 2 Gaussians, there are 8"),
        ("a.txt", [1], "unknown suffix '.txt'"),
    ],
)
def test_what_lists_no_rows(name: str, values: Any, fault: str, tmp_path: Path):
    with pytest.raises(StyleSplatError) as caught:
        read_rows(saved(tmp_path / name, values), COUNT, "pot")
    message = str(caught.value)
    assert fault in message and f"Cannot read Gaussians from {tmp_path / name}" in message
    assert "\n" not in message


def test_an_archive_of_several_arrays_and_a_ply_without_a_selection(tmp_path: Path):
    np.savez(tmp_path / "a.npz", a=np.arange(3), b=np.arange(3))
    with pytest.raises(StyleSplatError, match="of which one could be meant"):
        read_rows(tmp_path / "a.npz", COUNT, "pot")
    write_ply_table(np.zeros(COUNT, [("x", "<f4")]), tmp_path / "a.ply")
    with pytest.raises(StyleSplatError, match="no column 'state'"):
        read_rows(tmp_path / "a.ply", COUNT, "pot")
    with pytest.raises(StyleSplatError, match=r"lost\.npy"):
        read_rows(tmp_path / "lost.npy", COUNT, "pot")

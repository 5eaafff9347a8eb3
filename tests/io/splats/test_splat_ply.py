from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import pytest

from balls import same
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.ply import read_ply_table, write_ply_rows
from stylesplat.io.splats.splat_ply import read_splat_ply, write_splat_ply
from stylesplat.scene.splats import Splats

INRIA = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *(f"f_rest_{i}" for i in range(45)),
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]


def some(count: int = 7, degree: int = 3) -> Splats:
    return replace(random_splats(count, sh_degree=degree), identities=None)


def header(content: bytes) -> list[str]:
    return content[: content.index(b"end_header")].decode().splitlines()


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_bits_survive_the_round_trip(tmp_path: Path, count: int):
    splats = some(count)
    write_splat_ply(splats, tmp_path / "a.ply")
    found = read_splat_ply(tmp_path / "a.ply")
    assert same(found, splats)


def test_exactly_the_columns_of_inria(tmp_path: Path):
    write_splat_ply(some(), tmp_path / "a.ply")
    content = (tmp_path / "a.ply").read_bytes()
    assert header(content) == [
        *("ply", "format binary_little_endian 1.0", "element vertex 7"),
        *(f"property float {name}" for name in INRIA),
    ]
    assert len(content) == content.index(b"end_header\n") + 11 + 7 * 62 * 4


@pytest.mark.parametrize("degree", range(4))
def test_same_as_an_independent_writer_and_reader(tmp_path: Path, degree: int):
    splats = some(degree=degree)
    rows = (splats.means, splats.scales, splats.quats, splats.opacities, splats.sh0[:, 0])
    means, scales, quats, opacities, sh0 = (tensor.numpy() for tensor in rows)
    gsply.plywrite(
        tmp_path / "theirs.ply", means, scales, quats, opacities, sh0, splats.shN.numpy()
    )
    found = read_splat_ply(tmp_path / "theirs.ply")
    assert same(found, splats)
    write_splat_ply(splats, tmp_path / "ours.ply")
    theirs = gsply.plyread(tmp_path / "ours.ply")
    found = (theirs.means, theirs.scales, theirs.quats, theirs.opacities, theirs.sh0)
    for array, tensor in zip(found, rows, strict=True):
        np.testing.assert_array_equal(array, tensor)
    np.testing.assert_array_equal(theirs.shN[:, : splats.shN.shape[1]], splats.shN)


@pytest.mark.parametrize("order", ["shuffled", "big-endian", "float64", "extra"])
def test_other_layouts_of_the_same_numbers(tmp_path: Path, order: str):
    splats = some()
    write_splat_ply(splats, tmp_path / "a.ply")
    table = read_ply_table(tmp_path / "a.ply")
    names = np.random.default_rng(0).permutation(INRIA).tolist()
    if order == "extra":
        names = ["label", *names]
    kind = "<f8" if order == "float64" else "<f4"
    other = np.zeros(7, [(name, kind) for name in names])
    for name in INRIA:
        other[name] = table[name]
    write_ply_rows(tmp_path / "b.ply", 7, other.dtype, [other])
    if order == "big-endian":
        start, body = (tmp_path / "b.ply").read_bytes().split(b"end_header\n")
        swapped = np.frombuffer(body, "<f4").astype(">f4").tobytes()
        start = start.replace(b"little", b"big")
        (tmp_path / "b.ply").write_bytes(start + b"end_header\n" + swapped)
    found = read_splat_ply(tmp_path / "b.ply")
    assert same(found, splats)


FACES = b"element face 2\nproperty list uchar int vertex_indices\nproperty double area\n"
EDGES = b"element edge 2\nproperty int a\nproperty int b\n"


def replaced(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    return lambda content: content.replace(old, new)


def body(content: bytes) -> int:
    return content.index(b"end_header\n") + 11


DAMAGES: list[tuple[Callable[[bytes], bytes], str]] = [
    (lambda c: c[:-1], "truncated: 7 vertices take 1736 bytes, got 1735"),
    (
        replaced(b"element vertex", FACES + b"element vertex"),
        "before its vertex rows are lists of face",
    ),
    (replaced(b"vertex 7", b"vertex 999999999999"), "truncated: 999999999999 vertices"),
    (replaced(b"vertex 7", b"vertex -7"), "claims -7 rows of vertex"),
    (replaced(b"element vertex 7", b"comment none"), "of a PLY of vertices"),
    (replaced(b"format binary_little_endian 1.0\n", b""), "names no format"),
    (replaced(b" opacity\n", b" opacitx\n"), "no column opacity"),
    (replaced(b" f_rest_44\n", b" other\n"), "44 f_rest columns fit no degree"),
    (
        replaced(b"property float x\n", b"property list uchar int x\n"),
        "expected plain vertex rows, but 'x' is a list",
    ),
    (lambda c: c[:-4] + np.float32(np.nan).tobytes(), "1 values of quats are not finite"),
    (lambda c: c[:-4] + np.float32(1e6).tobytes(), "1 values of quats are out of range"),
]


@pytest.mark.parametrize(("damage", "match"), DAMAGES, ids=range(len(DAMAGES)))
def test_damaged_files(tmp_path: Path, damage: Callable[[bytes], bytes], match: str):
    path = tmp_path / "a.ply"
    write_splat_ply(some(), path)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(StyleSplatError, match=rf"Cannot read .*a\.ply.*{match}.*\. [A-Z].*\."):
        read_splat_ply(path)


@pytest.mark.parametrize(
    ("header", "rows"),
    [(b"", bytes(2)), (EDGES + FACES, bytes(16) + b"\3" + bytes(20) + b"\4" + bytes(24))],
)
def test_what_follows_the_vertices_is_skipped(tmp_path: Path, header: bytes, rows: bytes):
    splats, path = some(), tmp_path / "a.ply"
    write_splat_ply(splats, path)
    path.write_bytes(path.read_bytes().replace(b"end_header", header + b"end_header") + rows)
    assert same(read_splat_ply(path), splats)


@pytest.mark.parametrize("degree", range(4))
def test_fewer_columns_where_they_are_asked_for(tmp_path: Path, degree: int):
    splats = some(degree=degree)
    bands = splats.shN.shape[1]
    write_splat_ply(splats, tmp_path / "a.ply", bands=bands)
    names = [line.split()[-1] for line in header((tmp_path / "a.ply").read_bytes())[3:]]
    rest = [f"f_rest_{i}" for i in range(3 * bands)]
    assert names == [*INRIA[:9], *rest, *INRIA[-8:]]
    assert same(read_splat_ply(tmp_path / "a.ply"), splats)


def test_wrong_ascii_counts(tmp_path: Path):
    text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n1\n2\n"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(StyleSplatError, match="3 vertices take 3 lines, got 2"):
        read_ply_table(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_text(text + "three\n")
    with pytest.raises(StyleSplatError, match="three"):
        read_ply_table(tmp_path / "a.ply")

"""PLY files that hold one table: a row per vertex, a column per property."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import numpy as np
from jaxtyping import Shaped

from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import open_binary, reading

PLY_TYPES = {  # PLY's two sets of names, and numpy's
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
BYTE_ORDERS: dict[str, Literal["<", ">", "="]] = {
    "binary_little_endian": "<",
    "binary_big_endian": ">",
    "ascii": "=",
}
MAX_HEADER = 1 << 16  # bytes; real headers have about two thousand
AT_ONCE = 1 << 11  # rows: half a MB of a splat, which stays in the cache while columns are copied
REMEDY = "Copy or export it again, as a PLY of vertices."
VERTEX = "vertex"


class PlyElement(NamedTuple):
    """Rows of one kind, as the header announces them."""

    name: str
    rows: int
    columns: list[tuple[str, str]]
    """Names of properties, and numpy's types; of a list the type of its length."""
    lists: list[str]
    """Names of the properties that are lists."""


@dataclass(frozen=True)
class PlyRows:
    count: int
    dtype: np.dtype
    blocks: Iterator[Shaped[np.ndarray, " B"]]


def read_ply_table(path: Path | str) -> Shaped[np.ndarray, " N"]:
    """Read the vertices of a PLY file into a structured array."""
    with ply_rows(path, at_once=sys.maxsize) as rows:
        return next(rows.blocks, np.empty(0, rows.dtype))


@contextmanager
def ply_rows(path: Path | str, *, at_once: int) -> Iterator[PlyRows]:
    """The vertices of a PLY file in blocks of `at_once` rows: files may exceed the free memory.

    The count of the header is checked against the file's size before memory is allocated. What
    follows the vertices, such as faces, is skipped. Vertices with lists, or after other elements,
    are a StyleSplatError.
    """
    with open_binary(path) as file:
        with reading(path, REMEDY):
            rows = _open_rows(file, at_once)
        yield rows


def write_ply_table(table: Shaped[np.ndarray, " N"], path: Path | str) -> None:
    write_ply_rows(PlyRows(len(table), table.dtype, iter([table])), path)


def write_ply_rows(rows: PlyRows, path: Path | str) -> None:
    """Write rows as little-endian binary PLY, block by block."""
    names = rows.dtype.names
    assert names is not None
    columns = [f"property {PLY_NAMES[rows.dtype[n].str[1:]]} {n}" for n in names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {rows.count}"]
    header = "\n".join([*lines, *columns, "end_header\n"]).encode("ascii")
    with atomic_path(path) as draft, draft.open("wb") as file:
        file.write(header)
        for block in rows.blocks:
            file.write(np.ascontiguousarray(block).data)


def _open_rows(file: BinaryIO, at_once: int) -> PlyRows:
    encoding, elements, start = parse_header(file.read(MAX_HEADER))
    filled = [element for element in elements if element.rows or element.name == VERTEX]
    if not filled or not filled[0].columns:
        raise ValueError("its header names no vertices")
    vertices = filled[0]
    if vertices.name != VERTEX:
        raise ValueError(f"expected vertices first, but its header has 'element {vertices.name}'")
    if vertices.lists:
        raise ValueError(f"expected plain vertices, but their {vertices.lists[0]!r} is a list")
    file.seek(start)
    count, dtype = vertices.rows, np.dtype(vertices.columns).newbyteorder(BYTE_ORDERS[encoding])
    if encoding == "ascii":
        lines = file.read().decode("ascii", errors="replace").splitlines()
        lines = [line for line in lines if line.strip()]
        size, needed, unit = len(lines), count, "lines"
    else:
        size, needed = os.fstat(file.fileno()).st_size - start, count * dtype.itemsize
        lines, unit = [], "bytes"
    if size < needed:
        raise ValueError(f"it is truncated: {count} vertices take {needed} {unit}, got {size}")
    if encoding == "ascii":
        table = np.loadtxt(lines[:count], dtype, ndmin=1) if count else np.empty(0, dtype)
        blocks = iter([table])
    else:
        blocks = (
            np.fromfile(file, dtype, min(at_once, count - first))
            for first in range(0, count, at_once)
        )
    return PlyRows(count, dtype, blocks)


def parse_header(content: bytes) -> tuple[str, list[PlyElement], int]:
    """The encoding and the elements of a PLY file, and how many bytes its header has."""
    end = re.search(rb"^end_header\r?\n", content[:MAX_HEADER], re.MULTILINE)
    if not re.match(rb"ply\r?\n", content) or end is None:
        raise ValueError("it is not a PLY file")
    encoding, elements = "", list[PlyElement]()
    for line in content[: end.start()].decode("ascii", errors="replace").splitlines():
        match line.split():
            case ["format", name, "1.0"] if name in BYTE_ORDERS:
                encoding = name
            case ["element", name, number]:
                elements.append(PlyElement(name, int(number), [], []))
            case ["property", kind, name] if elements and kind in PLY_TYPES:
                elements[-1].columns.append((name, PLY_TYPES[kind]))
            case ["property", "list", kind, _, name] if elements and kind in PLY_TYPES:
                elements[-1].columns.append((name, PLY_TYPES[kind]))
                elements[-1].lists.append(name)
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"its header has {line!r}, which is not of a PLY of vertices")
    negative = [element for element in elements if element.rows < 0]
    if negative:
        raise ValueError(f"its header claims {negative[0].rows} rows of {negative[0].name}")
    if not encoding:
        raise ValueError("its header names no format")
    return encoding, elements, end.end()

"""PLY files that hold one table: a row per vertex, a column per property."""

import os
import re
from collections.abc import Iterable
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


def read_ply_table(path: Path | str) -> Shaped[np.ndarray, " N"]:
    """The vertices of a PLY file as a structured array; binary files are mapped into memory.

    The count of the header is checked against the file's size before memory is allocated. What
    follows the vertices, such as faces, is skipped. Vertices with lists, or after other elements,
    are a StyleSplatError.
    """
    with open_binary(path) as file, reading(path, REMEDY):
        return _read_table(file)


def write_ply_rows(
    path: Path | str, count: int, dtype: np.dtype, blocks: Iterable[Shaped[np.ndarray, " B"]]
) -> None:
    """Write rows as little-endian binary PLY, block by block."""
    assert dtype.names is not None
    columns = [f"property {PLY_NAMES[dtype[n].str[1:]]} {n}" for n in dtype.names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header = "\n".join([*lines, *columns, "end_header\n"]).encode("ascii")
    with atomic_path(path) as draft, draft.open("wb") as file:
        file.write(header)
        for block in blocks:
            file.write(np.ascontiguousarray(block).data)


def _read_table(file: BinaryIO) -> Shaped[np.ndarray, " N"]:
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
    if not count:
        return np.empty(0, dtype)
    if encoding == "ascii":
        return np.loadtxt(lines[:count], _with_doubles(dtype), ndmin=1)
    return np.memmap(file, dtype, "r", start, count)


def _with_doubles(dtype: np.dtype) -> np.dtype:
    """The columns of a text, which may have more digits than the float that its header says."""
    kinds = {name: dtype[name] for name in dtype.names or ()}
    return np.dtype([(n, "f8" if kind == np.float32 else kind) for n, kind in kinds.items()])


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

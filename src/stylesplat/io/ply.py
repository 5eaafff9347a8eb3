"""PLY files that hold one table: a row per vertex, a column per property."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Shaped

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import open_binary, reason
from stylesplat.progress import say

PLY_TYPES = {  # PLY's two sets of names, and numpy's
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
ASCII, LITTLE_ENDIAN, BIG_ENDIAN = "ascii", "binary_little_endian", "binary_big_endian"
MAX_HEADER = 1 << 16  # bytes; real headers have about two thousand
AT_ONCE = 1 << 11  # rows: half a MB of a splat, which stays in the cache while it is taken apart
REMEDY = "Copy or export it again, as a PLY of vertices."
VERTEX = "vertex"


class _Element(NamedTuple):
    """Rows of one kind, as the header announces them."""

    name: str
    rows: int
    columns: list[tuple[str, str]]
    """Names of properties, and numpy's types; of a list the type of its length."""
    lists: list[str]
    """Names of the properties that are lists."""


@dataclass(frozen=True)
class PlyRows:
    """The vertices of a file, in order, some at a time."""

    count: int
    """How many there are."""
    dtype: np.dtype
    """Their columns."""
    blocks: Iterator[Shaped[np.ndarray, " B"]]
    """The rows."""


def read_ply_table(path: Path | str) -> Shaped[np.ndarray, " N"]:
    """Read the vertices of a PLY file into a structured array.

    Raises:
        StyleSplatError: As `ply_rows` does.
    """
    with ply_rows(path, at_once=sys.maxsize) as rows:
        return next(rows.blocks, np.empty(0, rows.dtype))


@contextmanager
def ply_rows(path: Path | str, *, at_once: int) -> Iterator[PlyRows]:
    """The vertices of a PLY file, read some at a time: files may be larger than the free memory.

    The counts that the header claims are checked against the file's size before any memory is
    taken. Elements that follow the vertices, such as faces, are skipped; so are bytes that the
    header does not announce, which the user is told.

    Args:
        path: The file.
        at_once: Rows of a block.

    Raises:
        StyleSplatError: If the file is missing, no PLY or truncated, or its vertices hold lists or
            come after other elements.
    """
    with open_binary(path) as file:
        try:
            rows, left, what = _opened(file, at_once)
        except (ValueError, OverflowError) as error:
            raise StyleSplatError(f"Cannot read {path}: {reason(error)}. {REMEDY}") from error
        say_left_over(path, left, what)
        yield rows


def _opened(file: BinaryIO, at_once: int) -> tuple[PlyRows, int, str]:
    """The rows, and how much follows what the header announces."""
    header, start = _split(file.read(MAX_HEADER))
    encoding, vertices, later = _parse(header)
    file.seek(start)
    if encoding == ASCII:
        table, left = _ascii_rows(file.read(), vertices, later)
        return PlyRows(len(table), table.dtype, iter([table])), left, "line"
    dtype = np.dtype(vertices.columns).newbyteorder("<" if encoding == LITTLE_ENDIAN else ">")
    size = os.fstat(file.fileno()).st_size - start
    left = _left_over(size, vertices.rows, dtype, later)
    return PlyRows(vertices.rows, dtype, _blocks(file, vertices.rows, dtype, at_once)), left, "byte"


def _blocks(
    file: BinaryIO, count: int, dtype: np.dtype, at_once: int
) -> Iterator[Shaped[np.ndarray, " B"]]:
    for start in range(0, count, at_once):
        yield np.fromfile(file, dtype, min(at_once, count - start))


def say_left_over(path: Path | str, count: int, what: str = "byte") -> None:
    """Tell the user that a file holds more than its header announces, if it does."""
    if count:
        plural = "" if count == 1 else "s"
        say(
            f"{path} goes on for {count} {what}{plural} after what its header announces: left "
            "unread. If anything is missing, export it again."
        )


def write_ply_table(table: Shaped[np.ndarray, " N"], path: Path | str) -> None:
    """Write a structured array as little-endian binary PLY.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    write_ply_rows(PlyRows(len(table), table.dtype, iter([table])), path)


def write_ply_rows(rows: PlyRows, path: Path | str) -> None:
    """Write rows as little-endian binary PLY, as they come.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    names = rows.dtype.names
    assert names is not None
    columns = [f"property {PLY_NAMES[rows.dtype[n].str[1:]]} {n}" for n in names]
    lines = ["ply", f"format {LITTLE_ENDIAN} 1.0", f"element vertex {rows.count}"]
    header = "\n".join([*lines, *columns, "end_header\n"]).encode("ascii")
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(header)
        for block in rows.blocks:
            file.write(np.ascontiguousarray(block).data)


def _split(content: bytes) -> tuple[list[str], int]:
    """The lines of the header, and where the rows begin."""
    end = re.search(rb"^end_header\r?\n", content, re.MULTILINE)
    if not re.match(rb"ply\r?\n", content) or end is None:
        raise ValueError("it is not a PLY file")
    lines = content[: end.start()].decode("ascii", errors="replace").splitlines()
    return lines, end.end()


def _parse(header: list[str]) -> tuple[str, _Element, list[_Element]]:
    """The encoding, the vertices, and what follows them."""
    encoding, elements = "", list[_Element]()
    for line in header:
        match line.split():
            case ["format", name, "1.0"] if name in (ASCII, LITTLE_ENDIAN, BIG_ENDIAN):
                encoding = name
            case ["element", name, number]:
                elements.append(_Element(name, int(number), [], []))
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
    filled = [element for element in elements if element.rows or element.name == VERTEX]
    if not encoding or not filled or not filled[0].columns:
        raise ValueError("its header names no format or no vertices")
    return encoding, _plain_vertices(filled), filled[1:]


def _plain_vertices(elements: list[_Element]) -> _Element:
    """The first element, if it is of vertices that have a fixed size."""
    first = elements[0]
    if first.name != VERTEX:
        raise ValueError(f"expected vertices first, but its header has 'element {first.name}'")
    if first.lists:
        raise ValueError(f"expected plain vertices, but their {first.lists[0]!r} is a list")
    return first


def _left_over(size: int, count: int, dtype: np.dtype, later: list[_Element]) -> int:
    """How many of so many bytes nobody announced."""
    first = count * dtype.itemsize
    if size < first:
        raise ValueError(f"it is truncated: {count} vertices take {first} bytes, got {size}")
    least = sum(element.rows * np.dtype(element.columns).itemsize for element in later)
    if size - first < least:
        raise ValueError(
            f"it is truncated: {later[0].name!r} and what follows take {least} bytes or more, got "
            f"{size - first}"
        )
    sized = not any(element.lists for element in later)
    return size - first - least if sized else 0


def _ascii_rows(
    body: bytes, vertices: _Element, later: list[_Element]
) -> tuple[Shaped[np.ndarray, " N"], int]:
    """The vertices, and how many lines nobody announced."""
    lines = body.decode("ascii", errors="replace").splitlines()
    lines = [line for line in lines if line.strip()]
    if len(lines) < vertices.rows:
        raise ValueError(f"the header claims {vertices.rows} vertices, got {len(lines)} lines")
    left = len(lines) - vertices.rows - sum(element.rows for element in later)
    if left < 0:
        raise ValueError(f"it is truncated: {-left} lines after the vertices are missing")
    dtype = np.dtype(vertices.columns)
    if not vertices.rows:
        return np.empty(0, dtype), left
    return np.loadtxt(lines[: vertices.rows], dtype, ndmin=1), left

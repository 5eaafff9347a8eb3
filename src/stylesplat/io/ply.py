"""PLY files: a header that people's programs write in many ways, and tables of rows."""

import os
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import numpy as np
from jaxtyping import Shaped

from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import open_binary, reading

PLY_TYPES = {  # PLY's two sets of names, those of half floats, and numpy's
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
    **{"half": "f2", "float16": "f2"},
}
PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
BYTE_ORDERS: dict[str, Literal["<", ">", "="]] = {
    "binary_little_endian": "<",
    "binary_big_endian": ">",
    "ascii": "=",
}
PLY_MAX_HEADER = 1 << 20  # bytes; real headers have about two thousand, but comments hold anything
BOM = b"\xef\xbb\xbf"  # editors of Windows put it before UTF-8
PLY_MAGIC = re.compile(rb"(?:\xef\xbb\xbf)?ply[ \t]*(\r\n|\n|\r)", re.IGNORECASE)
LINE_END = re.compile(r"\r\n|\r|\n")  # and nothing else: a comment in Latin-1 may hold NEL
PLY_REMEDY = "Copy or export it again, as a PLY of vertices."
VERTEX = "vertex"
Table = Shaped[np.ndarray, " N"]


class PlyElement(NamedTuple):
    """Rows of one kind, as the header announces them."""

    name: str
    rows: int
    columns: list[tuple[str, str]]
    """Names of properties, and numpy's types; of a list the type of its length."""
    lists: list[str]
    """Names of the properties that are lists."""


class PlyHeader(NamedTuple):
    encoding: str
    elements: list[PlyElement]
    comments: list[str]
    size: int
    """Bytes before the first row."""


def read_ply_table(path: Path | str) -> Table:
    """The vertices of a PLY file as a structured array; binary files are mapped into memory.

    The count of the header is checked against the file's size before memory is allocated. Other
    elements are skipped. Vertices with lists, or after elements with lists, are a StyleSplatError.
    """
    return read_ply(path)[1][VERTEX]


def read_ply(
    path: Path | str, names: Collection[str] = (VERTEX,)
) -> tuple[PlyHeader, dict[str, Table]]:
    """The header of a PLY file, and its tables of these names; see `read_ply_table`."""
    with open_binary(path) as file, reading(path, PLY_REMEDY):
        header = parse_header(file.read(PLY_MAX_HEADER))
        known = [element.name for element in header.elements]
        vertices = next((e for e in header.elements if e.name == VERTEX), None)
        if vertices is None or not vertices.columns:
            has = f", but {', '.join(known)}" if known else ""
            raise ValueError(f"its header names no vertices{has:.80}")
        wanted = [name for name in names if name in known]
        read = _read_ascii if header.encoding == "ascii" else _read_binary
        return header, {name: read(file, header, known.index(name)) for name in wanted}


def read_header(path: Path | str) -> PlyHeader:
    with open_binary(path) as file, reading(path, PLY_REMEDY):
        return parse_header(file.read(PLY_MAX_HEADER))


def write_ply_rows(
    path: Path | str,
    count: int,
    dtype: np.dtype,
    blocks: Iterable[Shaped[np.ndarray, " B"]],
    *,
    comments: Sequence[str] = (),
) -> None:
    """Write rows as little-endian binary PLY, block by block."""
    assert dtype.names is not None
    columns = [f"property {PLY_NAMES[dtype[n].str[1:]]} {n}" for n in dtype.names]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {each}" for each in comments)]
    lines += [f"element vertex {count}", *columns, "end_header\n"]
    with atomic_path(path) as draft, draft.open("wb") as file:
        file.write("\n".join(lines).encode("ascii"))
        for block in blocks:
            file.write(np.ascontiguousarray(block).data)


def _read_binary(file: BinaryIO, header: PlyHeader, index: int) -> Table:
    dtypes = [
        np.dtype(element.columns).newbyteorder(BYTE_ORDERS[header.encoding])
        for element in header.elements[: index + 1]
    ]
    start = header.size
    for element, dtype in zip(header.elements[:index], dtypes, strict=False):
        if element.lists and element.rows:
            raise ValueError(
                f"before its {header.elements[index].name} rows are lists of {element.name}, "
                "whose size is unknown"
            )
        start += element.rows * dtype.itemsize
    rows = _check_plain(header.elements[index])
    size = max(os.fstat(file.fileno()).st_size - start, 0)
    _check_size(header.elements[index], rows * dtypes[-1].itemsize, size, "bytes")
    return np.memmap(file, dtypes[-1], "r", start, rows) if rows else np.empty(0, dtypes[-1])


def _read_ascii(file: BinaryIO, header: PlyHeader, index: int) -> Table:
    """The rows of an element, which have a line each, as those before it have."""
    file.seek(header.size)
    lines = re.split(r"[\r\n]+", file.read().decode("ascii", errors="replace"))
    lines = [line for line in lines if line.strip()]
    lines = lines[sum(element.rows for element in header.elements[:index]) :]
    element = header.elements[index]
    rows = _check_plain(element)
    _check_size(element, rows, len(lines), "lines")
    # A text may have more digits than the float that its header says
    dtype = np.dtype([(name, "f8" if kind == "f4" else kind) for name, kind in element.columns])
    return np.loadtxt(lines[:rows], dtype, ndmin=1) if rows else np.empty(0, dtype)


def _check_plain(element: PlyElement) -> int:
    """How many rows of numbers an element has; a ValueError if they are lists."""
    if element.lists:
        raise ValueError(f"expected plain {element.name} rows, but {element.lists[0]!r} is a list")
    return element.rows


def _check_size(element: PlyElement, needed: int, size: int, unit: str) -> None:
    if size < needed:
        what = "vertices" if element.name == VERTEX else f"rows of {element.name}"
        fault = f"{element.rows} {what} take {needed} {unit}, got {size}"
        raise ValueError(f"it is truncated: {fault}")


def parse_header(content: bytes) -> PlyHeader:
    """Read a header with line ends of any system, a byte order mark, blanks and odd comments."""
    magic = PLY_MAGIC.match(content)
    # Where lines end in CR alone, the first byte of a row may be the LF of another system
    mac = magic is not None and magic[1] == b"\r"
    last = rb"[\r\n][ \t]*end_header[ \t]*" + (rb"\r" if mac else rb"\r?\n")
    end = re.search(last, content[:PLY_MAX_HEADER])
    if magic is None or end is None:
        raise ValueError("its header has no end_header" if magic else "it is not a PLY file")
    encoding, elements, comments = "", list[PlyElement](), list[str]()
    for line in LINE_END.split(_text(content[magic.end() : end.start()])):
        match line.split():
            case ["format", name, *_] if name in BYTE_ORDERS:
                encoding = name
            case ["element", name, number]:
                elements.append(PlyElement(name, int(number), [], []))
            case ["property", kind, name] if elements and kind in PLY_TYPES:
                elements[-1].columns.append((name, PLY_TYPES[kind]))
            case ["property", "list", kind, _, name] if elements and kind in PLY_TYPES:
                elements[-1].columns.append((name, PLY_TYPES[kind]))
                elements[-1].lists.append(name)
            case ["comment" | "obj_info" as kind, *_]:
                comments.append(line.strip().removeprefix(kind).strip())
            case []:
                pass
            case _:
                raise ValueError(f"its header has {line!r}, which is not of a PLY of vertices")
    negative = [element for element in elements if element.rows < 0]
    if negative:
        raise ValueError(f"its header claims {negative[0].rows} rows of {negative[0].name}")
    if not encoding:
        raise ValueError("its header names no format")
    return PlyHeader(encoding, elements, comments, end.end())


def _text(content: bytes) -> str:
    try:
        return content.decode()
    except UnicodeDecodeError:
        return content.decode("latin-1")

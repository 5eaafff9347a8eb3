"""PLY files that hold one table: a row per vertex, a column per property."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path, read_bytes, reason

PLY_TYPES = {  # PLY's two sets of names, and numpy's
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar"}
ASCII, LITTLE_ENDIAN, BIG_ENDIAN = "ascii", "binary_little_endian", "binary_big_endian"
MAX_HEADER = 1 << 16  # bytes; real headers have about two thousand


def read_ply_table(path: Path | str) -> Shaped[np.ndarray, " N"]:
    """Read the vertices of a PLY file into a structured array.

    The count that the header claims is checked against the file's size before any memory is
    taken.

    Raises:
        StyleSplatError: If the file is missing, no PLY, truncated, too long, or holds lists or
            elements other than vertices.
    """
    content = read_bytes(path)
    try:
        header, body = _split(content)
        encoding, count, dtype = _parse(header)
        if encoding == ASCII:
            return _ascii_rows(body, count, dtype)
        return _binary_rows(
            body, count, dtype.newbyteorder("<" if encoding == LITTLE_ENDIAN else ">")
        )
    except (ValueError, OverflowError) as error:
        raise StyleSplatError(f"Cannot read {path}: {reason(error)}.") from error


def write_ply_table(table: Shaped[np.ndarray, " N"], path: Path | str) -> None:
    """Write a structured array as little-endian binary PLY.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    assert table.dtype.names is not None
    columns = [f"property {PLY_NAMES[table.dtype[n].str[1:]]} {n}" for n in table.dtype.names]
    lines = ["ply", f"format {LITTLE_ENDIAN} 1.0", f"element vertex {len(table)}"]
    header = "\n".join([*lines, *columns, "end_header\n"]).encode("ascii")
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(header)
        file.write(np.ascontiguousarray(table).data)


def _split(content: bytes) -> tuple[list[str], memoryview]:
    end = re.search(rb"^end_header\r?\n", content[:MAX_HEADER], re.MULTILINE)
    if not re.match(rb"ply\r?\n", content) or end is None:
        raise ValueError("it is not a PLY file")
    lines = content[: end.start()].decode("ascii", errors="replace").splitlines()
    return lines, memoryview(content)[end.end() :]


def _parse(header: list[str]) -> tuple[str, int, np.dtype]:
    encoding, counts, columns = "", {}, []
    for line in header:
        match line.split():
            case ["format", name, "1.0"] if name in (ASCII, LITTLE_ENDIAN, BIG_ENDIAN):
                encoding = name
            case ["element", name, number] if number == "0" or name == "vertex":
                counts[name] = int(number)
            case ["property", kind, name] if kind in PLY_TYPES and [*counts][-1:] == ["vertex"]:
                columns.append((name, PLY_TYPES[kind]))
            case ["property", *_] if counts and "vertex" not in [*counts][-1:]:
                pass  # of an element without rows
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"expected plain vertices only, but the header has {line!r}")
    if not encoding or not columns:
        raise ValueError("the PLY header names no format or no vertices")
    return encoding, counts["vertex"], np.dtype(columns)


def _binary_rows(body: memoryview, count: int, dtype: np.dtype) -> Shaped[np.ndarray, " N"]:
    expected = count * dtype.itemsize
    if len(body) != expected:
        fault = "truncated" if len(body) < expected else "followed by something else"
        raise ValueError(f"it is {fault}: {count} vertices take {expected} bytes, got {len(body)}")
    return np.frombuffer(body, dtype)


def _ascii_rows(body: memoryview, count: int, dtype: np.dtype) -> Shaped[np.ndarray, " N"]:
    lines = bytes(body).decode("ascii", errors="replace").splitlines()
    lines = [line for line in lines if line.strip()]
    if len(lines) != count:
        raise ValueError(f"the header claims {count} vertices, got {len(lines)} lines")
    if not lines:
        return np.empty(0, dtype)
    return np.loadtxt(lines, dtype, ndmin=1)

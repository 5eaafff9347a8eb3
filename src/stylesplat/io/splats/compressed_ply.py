"""SuperSplat's compressed PLY: chunks of 256 Gaussians packed between their bounds."""

import re
from pathlib import Path

import gsply

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.gsply_data import from_gsply
from stylesplat.io.splats.splat_ply import REST_COUNTS
from stylesplat.scene.splats import Splats

CHUNK = 256  # Gaussians that share their bounds
ELEMENT = re.compile(rb"^element (\w+) (\d{1,10})\r?$", re.MULTILINE)
PROPERTY = re.compile(rb"^property (\w+) \w+\r?$", re.MULTILINE)
SIZES = {b"float": 4, b"uint": 4, b"uchar": 1}  # bytes of the types that the format has
MAX_HEADER = 1 << 16  # bytes


def is_compressed(content: bytes) -> bool:
    """Whether a PLY file is of this kind, from its first bytes."""
    header = _header(content)
    return b"\nelement chunk " in header and b"packed_position" in header


def read_compressed_ply(path: Path | str, content: bytes) -> Splats:
    """Read a compressed PLY file that was loaded already.

    Raises:
        StyleSplatError: If it is damaged, or its header claims other counts than it holds.
    """
    fault = _fault(content)
    if fault:
        raise StyleSplatError(f"Cannot read {path}: {fault}. Export it again.")
    try:
        data = gsply.decompress_from_bytes(content)
    except (ValueError, KeyError, IndexError) as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. Export it again.") from error
    return from_gsply(data, path)


def _fault(content: bytes) -> str | None:
    """What is wrong with the counts and sizes, if anything; the reader trusts them."""
    header = _header(content)
    starts = [*ELEMENT.finditer(header)]
    if not starts:
        return "its header names no elements"
    counts = {match[1]: int(match[2]) for match in starts}
    ends = [*(match.start() for match in starts[1:]), len(header)]
    expected, columns = 0, {}
    for match, end in zip(starts, ends, strict=True):
        kinds = PROPERTY.findall(header[match.end() : end])
        if not all(kind in SIZES for kind in kinds):
            return "its header has properties of other types than this format"
        expected += int(match[2]) * sum(SIZES[kind] for kind in kinds)
        columns[match[1]] = len(kinds)
    vertices = counts.get(b"vertex", 0)
    if counts.get(b"chunk") != -(-vertices // CHUNK) or counts.get(b"sh", vertices) != vertices:
        return "its numbers of chunks and vertices do not fit"
    if columns.get(b"sh", 0) not in REST_COUNTS:
        return f"{columns[b'sh']} columns of colour fit no degree up to 3"
    held = len(content) - len(header) - len(_end(content))
    if held != expected:
        return f"its header announces {expected} bytes, it holds {held}"
    return None


def _end(content: bytes) -> bytes:
    found = re.search(rb"end_header\r?\n", content[:MAX_HEADER])
    return found[0] if found else b""


def _header(content: bytes) -> bytes:
    end = _end(content)
    return content[: content.index(end)] if end else b""

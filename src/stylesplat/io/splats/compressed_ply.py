"""SuperSplat's compressed PLY: chunks of 256 Gaussians packed between their bounds."""

import re
from pathlib import Path

import gsply

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.ply import say_left_over
from stylesplat.io.splats.gsply_data import from_gsply, to_gsply
from stylesplat.io.splats.morton import morton_order
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
    """Read a compressed PLY file that was loaded already; what follows the Gaussians is left.

    Raises:
        StyleSplatError: If it is damaged, or its header claims other counts than it holds.
    """
    fault = _fault(content) or _short(content)
    if fault:
        raise StyleSplatError(f"Cannot read {path}: {fault}. Export it again.")
    announced = _announced(content)
    say_left_over(path, len(content) - announced)
    try:
        data = gsply.decompress_from_bytes(content[:announced])
    except (ValueError, KeyError, IndexError) as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. Export it again.") from error
    return from_gsply(data, path)


def write_compressed_ply(splats: Splats, path: Path | str) -> None:
    """Write the form that SuperSplat compresses splats to, their numbers rounded.

    Neighbours in space share a chunk, so the Gaussians come in another order. In each chunk a
    position and a size have 10 or 11 bits between its bounds, a colour and an opacity 8, a
    rotation 32 altogether; higher bands of colour have 8 bits between -4 and 4.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    sorted_splats = splats[morton_order(splats.means)]
    content = gsply.compress_to_bytes(to_gsply(sorted_splats))
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def _fault(content: bytes) -> str | None:
    """What is wrong with the header's counts and columns, if anything; the reader trusts them."""
    counts, kinds = _elements(content)
    if not counts:
        return "its header names no elements"
    if not all(kind in SIZES for some in kinds.values() for kind in some):
        return "its header has properties of other types than this format"
    vertices = counts.get(b"vertex", 0)
    if counts.get(b"chunk") != -(-vertices // CHUNK) or counts.get(b"sh", vertices) != vertices:
        return "its numbers of chunks and vertices do not fit"
    columns = len(kinds.get(b"sh", ()))
    if columns not in REST_COUNTS:
        return f"{columns} columns of colour fit no degree up to 3"
    return None


def _short(content: bytes) -> str | None:
    """What is missing of what the header announces."""
    announced = _announced(content)
    if len(content) >= announced:
        return None
    return f"its header announces a file of {announced} bytes, it holds {len(content)}"


def _announced(content: bytes) -> int:
    """How many bytes the file has to have by its header."""
    counts, kinds = _elements(content)
    rows = sum(counts[name] * sum(SIZES[kind] for kind in kinds[name]) for name in counts)
    return len(_header(content)) + len(_end(content)) + rows


def _elements(content: bytes) -> tuple[dict[bytes, int], dict[bytes, list[bytes]]]:
    """The rows of each element, and the types of its properties."""
    header = _header(content)
    starts = [*ELEMENT.finditer(header)]
    ends = [*(match.start() for match in starts[1:]), len(header)]
    spans = {match[1]: header[match.end() : end] for match, end in zip(starts, ends, strict=False)}
    counts = {match[1]: int(match[2]) for match in starts}
    return counts, {name: PROPERTY.findall(span) for name, span in spans.items()}


def _end(content: bytes) -> bytes:
    found = re.search(rb"end_header\r?\n", content[:MAX_HEADER])
    return found[0] if found else b""


def _header(content: bytes) -> bytes:
    end = _end(content)
    return content[: content.index(end)] if end else b""

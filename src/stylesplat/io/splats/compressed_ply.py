"""SuperSplat's compressed PLY: chunks of 256 Gaussians packed between their bounds."""

import re
from pathlib import Path

import gsply
import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.ply import report_extra
from stylesplat.io.splats.packing import morton_order
from stylesplat.io.splats.splat_ply import REST_COUNTS, check_splats
from stylesplat.scene.splats import Splats

CHUNK = 256  # Gaussians that share their bounds
ELEMENT = re.compile(rb"^element (\w+) (\d{1,10})\r?$", re.MULTILINE)
PROPERTY = re.compile(rb"^property (\w+) \w+\r?$", re.MULTILINE)
SIZES = {b"float": 4, b"uint": 4, b"uchar": 1}  # bytes of the types that the format has
MAX_HEADER = 1 << 16  # bytes


def is_compressed(content: bytes) -> bool:
    """Whether a PLY file is of this kind, from its first bytes."""
    header = content[: _header_size(content)]
    return b"\nelement chunk " in header and b"packed_position" in header


def read_compressed_ply(path: Path | str, content: bytes) -> Splats:
    """Read the content of a compressed PLY file; what follows the Gaussians is ignored."""
    counts, kinds = _elements(content[: _header_size(content)])
    fault = _fault(counts, kinds)
    if fault is None:
        rows = sum(counts[name] * sum(SIZES[kind] for kind in kinds[name]) for name in counts)
        announced = _header_size(content) + rows
        if announced > len(content):
            fault = f"its header announces a file of {announced} bytes, it holds {len(content)}"
        else:
            report_extra(path, len(content) - announced)
            try:
                return from_gsply(gsply.decompress_from_bytes(content[:announced]), path)
            except (ValueError, KeyError, IndexError) as error:
                fault = str(error)
    raise StyleSplatError(f"Cannot read {path}: {fault}. Export it again.")


def write_compressed_ply(splats: Splats, path: Path | str) -> None:
    """Write the form that SuperSplat compresses splats to, in Morton order, its numbers rounded.

    In each chunk of neighbours a position and a scale have 10 or 11 bits between its bounds, a
    colour and an opacity 8, a rotation 32 altogether; higher bands have 8 bits between -4 and 4.
    """
    content = gsply.compress_to_bytes(to_gsply(splats[morton_order(splats.means)]))
    with atomic_path(path) as draft:
        draft.write_bytes(content)


def from_gsply(data: gsply.GSData, path: Path | str) -> Splats:
    """Splats from gsply's container, which has PLY's conventions."""
    count = len(data.means)
    higher = np.zeros((count, 0, 3), np.float32) if data.shN is None else data.shN
    columns = (data.means, data.quats, data.scales, data.opacities, data.sh0, higher)
    means, quats, scales, opacities, sh0, shN = (
        torch.from_numpy(np.ascontiguousarray(values, np.float32)) for values in columns
    )
    splats = Splats(means, quats, scales, opacities.reshape(count), sh0.reshape(count, 1, 3), shN)
    return check_splats(splats, path)


def to_gsply(splats: Splats) -> gsply.GSData:
    """Splats as gsply's container, their quaternions as they are."""
    return gsply.GSData(
        means=splats.means.numpy(),
        scales=splats.scales.numpy(),
        quats=splats.quats.numpy(),
        opacities=splats.opacities.numpy(),
        sh0=splats.sh0[:, 0].numpy(),
        shN=splats.shN.numpy(),
    )


def _fault(counts: dict[bytes, int], kinds: dict[bytes, list[bytes]]) -> str | None:
    """What is wrong with the counts and columns of the header, which gsply trusts."""
    if not counts:
        return "its header names no elements"
    if not all(kind in SIZES for each in kinds.values() for kind in each):
        return "its header has properties of other types than this format"
    vertices = counts.get(b"vertex", 0)
    if counts.get(b"chunk") != -(-vertices // CHUNK) or counts.get(b"sh", vertices) != vertices:
        return "its numbers of chunks and vertices do not fit"
    columns = len(kinds.get(b"sh", ()))
    if columns not in REST_COUNTS:
        return f"{columns} columns of colour fit no degree up to 3"
    return None


def _elements(header: bytes) -> tuple[dict[bytes, int], dict[bytes, list[bytes]]]:
    """The number of rows and the types of the properties of each element."""
    starts = [*ELEMENT.finditer(header)]
    ends = [*(match.start() for match in starts[1:]), len(header)]
    spans = {match[1]: header[match.end() : end] for match, end in zip(starts, ends, strict=False)}
    counts = {match[1]: int(match[2]) for match in starts}
    return counts, {name: PROPERTY.findall(span) for name, span in spans.items()}


def _header_size(content: bytes) -> int:
    """Bytes of the header with its last line; 0 without one."""
    end = re.search(rb"end_header\r?\n", content[:MAX_HEADER])
    return end.end() if end else 0

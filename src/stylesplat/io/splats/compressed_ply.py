"""SuperSplat's compressed PLY: chunks of 256 Gaussians packed between their bounds."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import gsply
import numpy as np
import torch

from stylesplat.io.atomic import atomic_path
from stylesplat.io.ply import PlyElement, parse_header
from stylesplat.io.splats.packing import morton_order
from stylesplat.io.splats.splat_ply import BANDS
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import ORIGIN, Offset, choose_offset, to_world

CHUNK = 256  # Gaussians that share their bounds
TYPES = ("f4", "u4", "u1")  # of the properties that the format has


def is_compressed(content: bytes) -> bool:
    """Whether a PLY file is of this kind, from its first bytes."""
    header = content.partition(b"end_header")[0]
    return b"\nelement chunk " in header and b"packed_position" in header


def read_compressed_ply(content: bytes) -> Splats:
    """Read the content of a compressed PLY file; what follows the Gaussians is ignored."""
    _, elements, start = parse_header(content)
    _check_elements({element.name: element for element in elements})
    size = start + sum(element.rows * np.dtype(element.columns).itemsize for element in elements)
    if size > len(content):
        raise ValueError(f"its header announces a file of {size} bytes, it holds {len(content)}")
    moved, offset = _without_offset(content[:size], elements, start)
    splats = from_gsply(gsply.decompress_from_bytes(moved))
    return splats if offset == ORIGIN else replace(splats, means=to_world(splats.means, offset))


def _without_offset(
    content: bytes, elements: Sequence[PlyElement], start: int
) -> tuple[bytes, Offset]:
    """A file whose chunks are near the origin, and what was subtracted: gsply has 32 bits."""
    before = takewhile(lambda element: element.name != "chunk", elements)
    start += sum(element.rows * np.dtype(element.columns).itemsize for element in before)
    chunk = next(element for element in elements if element.name == "chunk")
    chunks = np.frombuffer(content, np.dtype(chunk.columns), chunk.rows, start).copy()
    corners = [np.stack([chunks[f"{end}_{axis}"] for axis in "xyz"], 1) for end in ("min", "max")]
    offset = choose_offset(torch.from_numpy(np.concatenate(corners)))
    if offset == ORIGIN:
        return content, offset
    for axis, shift in zip("xyz", offset, strict=True):
        for end in ("min", "max"):
            chunks[f"{end}_{axis}"] = chunks[f"{end}_{axis}"].astype(np.float64) - shift
    return content[:start] + chunks.tobytes() + content[start + chunks.nbytes :], offset


def _check_elements(elements: dict[str, PlyElement]) -> None:
    """Raise a ValueError for counts and columns of the header, which gsply trusts."""
    if any(element.lists for element in elements.values()) or not all(
        kind in TYPES for element in elements.values() for _, kind in element.columns
    ):
        raise ValueError("its header has properties of other types than this format")
    vertices, bands = elements["vertex"].rows, elements.get("sh")
    if elements["chunk"].rows != -(-vertices // CHUNK) or (bands and bands.rows != vertices):
        raise ValueError("its numbers of chunks and vertices do not fit")
    columns = len(bands.columns) if bands else 0
    if columns not in [3 * each for each in BANDS]:
        raise ValueError(f"{columns} columns of colour fit no degree up to 3")


def write_compressed_ply(splats: Splats, path: Path | str) -> None:
    """Write the form that SuperSplat compresses splats to, in Morton order, its numbers rounded.

    In each chunk of neighbours a position and a scale have 10 or 11 bits between its bounds, a
    colour and an opacity 8, a rotation 32 altogether; higher bands have 8 bits between -4 and 4.
    """
    content = gsply.compress_to_bytes(to_gsply(splats[morton_order(splats.means)]))
    with atomic_path(path) as draft:
        draft.write_bytes(content)


def from_gsply(data: gsply.GSData) -> Splats:
    """Splats from gsply's container, which has PLY's conventions."""
    count = len(data.means)
    higher = np.zeros((count, 0, 3), np.float32) if data.shN is None else data.shN
    columns = (data.means, data.quats, data.scales, data.opacities, data.sh0, higher)
    means, quats, scales, opacities, sh0, shN = (
        torch.from_numpy(np.ascontiguousarray(values, np.float32)) for values in columns
    )
    return Splats(means, quats, scales, opacities.reshape(count), sh0.reshape(count, 1, 3), shN)


def to_gsply(splats: Splats) -> gsply.GSData:
    """Splats as gsply's container, their quaternions as they are."""
    names = ("means", "scales", "quats", "opacities", "shN")
    columns = {name: getattr(splats, name).numpy() for name in names}
    return gsply.GSData(**columns, sh0=splats.sh0[:, 0].numpy())

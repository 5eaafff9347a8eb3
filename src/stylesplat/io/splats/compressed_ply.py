"""SuperSplat's compressed PLY: chunks of 256 Gaussians packed between their bounds."""

from pathlib import Path

import gsply
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.io.atomic import write_file
from stylesplat.io.ply import VERTEX, PlyHeader, Table, read_header, read_ply
from stylesplat.io.splats.packing import (
    PACKED_LARGEST,
    PACKED_NEAR,
    from_smallest_three,
    morton_order,
)
from stylesplat.io.splats.splat_ply import BANDS, MARK, REST, is_antialiased
from stylesplat.scene.splats import Splats, sh0_from_rgb

COMPRESSED_CHUNK = 256  # Gaussians that share their bounds
CHUNKS, HIGHER = "chunk", "sh"  # elements beside the vertices
PACKED = tuple(f"packed_{name}" for name in ("position", "rotation", "scale", "color"))
TYPES = ("f4", "u4", "u1")  # of the properties that the format has
SH_REACH = 4.0  # of higher bands, to both sides of 0


def is_compressed(header: PlyHeader) -> bool:
    """Whether a PLY file is of this kind."""
    return any(PACKED[0] in dict(element.columns) for element in header.elements)


def read_compressed_ply(path: Path | str) -> Splats:
    """Read a compressed PLY file; what follows the Gaussians is ignored.

    Its chunks have 18 bounds, or 12 if an older SuperSplat wrote it: then colours go from 0 to 1.
    """
    _check_elements(read_header(path))
    header, tables = read_ply(path, (CHUNKS, VERTEX, HIGHER))
    vertices, chunks = tables[VERTEX], tables[CHUNKS]
    chunk = np.arange(len(vertices)) // COMPRESSED_CHUNK
    places, turns, sizes, colors = (np.array(vertices[name], np.int64) for name in PACKED)

    def between(shares: Float[np.ndarray, "N 3"], kind: str, names: str) -> Float[Tensor, "N 3"]:
        low, high = (_bounds(chunks, f"{end}_{kind}", names)[chunk] for end in ("min", "max"))
        return torch.from_numpy(low + (high - low) * shares)

    rgba, largest = _shares(colors, 8, 8, 8, 8), torch.from_numpy(turns >> 30)
    others = torch.from_numpy(_shares(turns, 10, 10, 10)) * 2 - 1
    colored = "min_r" in (chunks.dtype.names or ())
    rgb = between(rgba[:, :3], "", "rgb") if colored else torch.from_numpy(rgba[:, :3])
    return Splats(
        means=between(_shares(places, 11, 10, 11), "", "xyz"),
        quats=from_smallest_three(largest, (others * PACKED_LARGEST).float()),
        scales=between(_shares(sizes, 11, 10, 11), "scale_", "xyz").float(),
        opacities=torch.from_numpy(rgba[:, 3]).clamp(PACKED_NEAR, 1 - PACKED_NEAR).logit().float(),
        sh0=sh0_from_rgb(rgb)[:, None].float(),
        shN=_higher_bands(tables.get(HIGHER), len(vertices)),
        antialiased=is_antialiased(path, header.comments),
    )


def _shares(packed: Int[np.ndarray, " N"], *bits: int) -> Float[np.ndarray, "N D"]:
    """Fields of some bits each, the last of them lowest, as shares of their largest number."""
    shifts = np.cumsum([0, *bits[:0:-1]])[::-1]
    most = [2**each - 1 for each in bits]
    return (packed[:, None] >> shifts & most) / most


def _bounds(chunks: Table, kind: str, names: str) -> Float[np.ndarray, "C 3"]:
    return np.stack([chunks[kind + name].astype(np.float64) for name in names], axis=1)


def _higher_bands(table: Table | None, count: int) -> Float[Tensor, "N _ 3"]:
    """Bytes that stand for the middle of their step, but at both ends; channel by channel."""
    if table is None:
        return torch.zeros(count, 0, 3)
    bands = len(table.dtype.names or ()) // 3
    values = SH_REACH * (np.array([0, *(np.arange(1, 255) + 0.5), 256]) / 128 - 1)
    shN = np.empty((count, bands, 3), np.float32)
    for number in range(3 * bands):
        channel, band = divmod(number, bands)
        shN[:, band, channel] = values.astype(np.float32)[table[f"{REST}{number}"]]
    return torch.from_numpy(shN)


def _check_elements(header: PlyHeader) -> None:
    """Raise a ValueError for counts and columns of the header that do not fit each other."""
    elements = {element.name: element for element in header.elements}
    if not {CHUNKS, VERTEX} <= elements.keys():
        raise ValueError("its header names no chunks, or no vertices")
    if any(element.lists for element in elements.values()) or not all(
        kind in TYPES for element in elements.values() for _, kind in element.columns
    ):
        raise ValueError("its header has properties of other types than this format")
    vertices, bands = elements[VERTEX].rows, elements.get(HIGHER)
    if elements[CHUNKS].rows != -(-vertices // COMPRESSED_CHUNK) or (
        bands and bands.rows != vertices
    ):
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
    if splats.antialiased:
        content = content.replace(b"\nelement", f"\ncomment {MARK}\nelement".encode(), 1)
    write_file(path, content)


def to_gsply(splats: Splats) -> gsply.GSData:
    """Splats as gsply's container, their quaternions as they are."""
    names = ("means", "scales", "quats", "opacities", "shN")
    columns = {name: getattr(splats, name).numpy() for name in names}
    return gsply.GSData(**columns, sh0=splats.sh0[:, 0].numpy())

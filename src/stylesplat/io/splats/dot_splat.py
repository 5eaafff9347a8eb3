"""Splats as .splat, one colour per Gaussian, and from .ksplat, in PLY's axes.

A .splat has rows of 32 bytes, as in antimatter15/splat. A .ksplat is laid out as GaussianSplats3D's
SplatBuffer (https://github.com/mkkellogg/GaussianSplats3D): a header, the headers of the sections,
the sections. A section has buckets, whose centres compressed positions are relative to, and rows.
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from stylesplat.io.atomic import write_file
from stylesplat.io.files import read_bytes
from stylesplat.io.splats.packing import PACKED_SMALLEST, to_bytes, to_floats, unit_quats
from stylesplat.io.splats.splat_ply import MAX_DEGREE, joined
from stylesplat.scene.splats import Splats, rgb_from_sh0, sh0_from_rgb

DOT_SPLAT_ROW = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)]
)
HALF_STEP = 0.5 / 255  # an opacity of 0 or 1 has no logit


def read_dot_splat(path: Path | str) -> Splats:
    content = read_bytes(path)
    if len(content) % DOT_SPLAT_ROW.itemsize:
        fault = f"its {len(content)} bytes are no whole number of rows of {DOT_SPLAT_ROW.itemsize}"
        raise ValueError(f"{fault}: it is cut off, or no .splat")
    rows = np.frombuffer(content, DOT_SPLAT_ROW)
    sh0, opacities = from_rgba(rows["rgba"])
    codes = to_floats(rows["quat"])
    quats = ((codes - 128) / 128).where(codes.any(dim=1, keepdim=True), 0.0)  # of rows of zeros
    return Splats(
        means=to_floats(rows["mean"]),
        quats=quats,
        scales=to_floats(rows["scale"]).abs().log(),  # viewers square them
        opacities=opacities,
        sh0=sh0,
        shN=torch.zeros(len(rows), 0, 3),
    )


def from_rgba(
    pixels: UInt8[np.ndarray, "N 4"],
) -> tuple[Float[Tensor, "N 1 3"], Float[Tensor, " N"]]:
    """The constant band of colour, and the logits of opacities."""
    rgba = to_floats(pixels) / 255
    return sh0_from_rgb(rgba[:, None, :3]), rgba[:, 3].clamp(HALF_STEP, 1 - HALF_STEP).logit()


def write_dot_splat(splats: Splats, path: Path | str) -> None:
    """Write a .splat file, the largest and most opaque Gaussians first."""
    alphas, order = torch.sigmoid(splats.opacities), dot_splat_order(splats)
    colors = rgb_from_sh0(splats.sh0[:, 0])
    rows = np.empty(len(splats), DOT_SPLAT_ROW)
    rows["mean"] = splats.means[order].numpy()
    rows["scale"] = splats.scales[order].exp().clamp(min=PACKED_SMALLEST).numpy()
    rows["rgba"] = to_bytes(255 * torch.cat([colors, alphas[:, None]], dim=1))[order]
    rows["quat"] = to_bytes(128 + 128 * unit_quats(splats.quats))[order]
    write_file(path, rows.tobytes())


def dot_splat_order(splats: Splats) -> Int[Tensor, " N"]:
    """The Gaussian of each row: the largest and most opaque first."""
    sizes = splats.scales.sum(dim=1).exp() * torch.sigmoid(splats.opacities)
    return torch.argsort(sizes, descending=True, stable=True)


DOT_SPLAT_MAGIC = b"\0\1\0\0"  # version 0.1, and what is 0; no .splat begins at x = 4e-43
# Version, sections, Gaussians, level of compression, bounds of higher bands in bytes
DOT_SPLAT_HEADER = struct.Struct("<2B2xI8xIH14x2f4052x")
# Gaussians, those of a full bucket, buckets, side of a bucket, bytes of a bucket, half the range of
# a compressed coordinate, full buckets, others, degree of colour
SECTION = struct.Struct("<4xIIIfH2xI4xIIH982x")
# By level of compression: kinds of a position, of scales and rotation, of higher bands
DOT_SPLAT_LEVELS = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))
HALF_RANGE = 32767  # of a compressed position, where the section names none
SH_RANGE = 1.5  # of higher bands in bytes, where the header names none


def read_ksplat(path: Path | str) -> Splats:
    """Read all sections, one after the other, with the bands that the richest of them has."""
    content = read_bytes(path)
    major, minor, sections, count, level, *bounds = DOT_SPLAT_HEADER.unpack_from(content)
    if major == minor == 0:
        raise ValueError("it is of version 0.0, or no .ksplat")
    if level >= len(DOT_SPLAT_LEVELS):
        raise ValueError(f"its level of compression is {level}, not 0 to 2")
    start = DOT_SPLAT_HEADER.size + sections * SECTION.size
    parts = list[Splats]()
    for index in range(sections):
        section = SECTION.unpack_from(content, DOT_SPLAT_HEADER.size + index * SECTION.size)
        part, start = _read_section(content, start, section, level, bounds)
        parts.append(part)
    total = sum(map(len, parts))
    if total != count:
        raise ValueError(f"its sections hold {total} Gaussians instead of {count}")
    return joined(parts)


def _read_section(
    content: bytes, start: int, section: tuple[Any, ...], level: int, bounds: Sequence[float]
) -> tuple[Splats, int]:
    """The splats of the section that starts there, and where the next one does."""
    count, bucket_size, buckets, block, storage, half, full, partial, degree = section
    if degree > MAX_DEGREE:
        raise ValueError(f"it has colours of degree {degree}, not 0 to 3")
    place, size, band = DOT_SPLAT_LEVELS[level]
    dtype = np.dtype(
        [("mean", place, 3), ("scale", size, 3), ("quat", size, 4), ("rgba", "u1", 4)]
        + [(f"band{each}", band, (3, 2 * each + 1)) for each in range(1, degree + 1)]
    )
    rest = np.frombuffer(content, "<u4", partial, start).astype(np.int64)
    start += 4 * partial
    rows_start = start + buckets * storage
    rows = np.frombuffer(content, dtype, count, rows_start)
    means = rows["mean"].astype(np.float64)
    if place != "<f4":
        centres = np.frombuffer(content, "<f4", 3 * buckets, start).reshape(-1, 3)
        if full + partial != buckets or full * bucket_size + rest.sum() != count:
            raise ValueError("its buckets do not hold as many Gaussians as their section")
        half = half or HALF_RANGE
        filled = np.concatenate([np.full(full, bucket_size), rest])
        means = (means - half) * (block / 2 / half) + np.repeat(centres, filled, axis=0)
    # Within a degree all of red come first, then green, then blue
    higher = [rows[f"band{each}"].transpose(0, 2, 1) for each in range(1, degree + 1)]
    shN = to_floats(np.concatenate([np.zeros((count, 0, 3), band), *higher], axis=1))
    if band == "u1":
        low, high = bounds[0] or -SH_RANGE, bounds[1] or SH_RANGE
        shN = low + shN / 255 * (high - low)
    sh0, opacities = from_rgba(rows["rgba"])
    quats = to_floats(rows["quat"])
    scales = to_floats(rows["scale"]).abs().log()  # 0 where half floats have none so small
    splats = Splats(torch.from_numpy(means), quats, scales, opacities, sh0, shN)
    return splats, rows_start + rows.nbytes

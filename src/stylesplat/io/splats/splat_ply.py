"""Splats as PLY files with exactly the columns of the INRIA code, which every viewer opens."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.declared import GAUSSIANS, check_range
from stylesplat.io.ply import read_ply_table, write_ply_table
from stylesplat.scene.splats import Splats

FULL_BANDS = 15  # higher bands of spherical harmonics at degree 3
REST_COUNTS = (0, 3 * 3, 3 * 8, 3 * FULL_BANDS)  # columns at each degree
MEANS = ("x", "y", "z")
SH0 = tuple(f"f_dc_{i}" for i in range(3))
OPACITY = ("opacity",)
SCALES = tuple(f"scale_{i}" for i in range(3))
QUATS = tuple(f"rot_{i}" for i in range(4))
REMEDY = "Remove those Gaussians, or make the file again."
SMALLEST_TURN = 1e-10  # of a part of a rotation: squares of less vanish in float32
NORMALS = ("nx", "ny", "nz")  # always 0; some viewers count on them


def read_splat_ply(path: Path | str) -> Splats:
    """Read splats of degree 0 to 3, their columns in any order; other columns are ignored.

    Raises:
        StyleSplatError: If the file is missing, truncated or too long, lacks a column or holds
            numbers that are not finite.
    """
    table = read_ply_table(path)
    rest = _find_rest(table, path)
    return check_splats(
        Splats(
            means=_columns(table, MEANS),
            quats=_columns(table, QUATS),
            scales=_columns(table, SCALES),
            opacities=_columns(table, OPACITY)[:, 0],
            sh0=_columns(table, SH0)[:, None],
            shN=_columns(table, rest).unflatten(1, (3, len(rest) // 3)).mT.contiguous(),
        ),
        path,
    )


def check_splats(splats: Splats, path: Path | str) -> Splats:
    """The splats of a file, if all numbers can be of splats and all Gaussians have a rotation.

    Raises:
        StyleSplatError: If not.
    """
    fault = splat_fault(splats)
    if fault:
        raise StyleSplatError(f"Cannot read {path} as splats: {fault}. {REMEDY}")
    return splats


def splat_fault(splats: Splats) -> str | None:
    """Why these cannot be splats: a number is not finite or absurd, or a rotation is none."""
    try:
        for name, declared in GAUSSIANS.items():
            check_range(name, getattr(splats, name), declared)
    except ValueError as error:
        return str(error)
    unturned = int((splats.quats.abs() < SMALLEST_TURN).all(dim=1).sum())
    return f"the rotations of {unturned} Gaussians are 0" if unturned else None


def write_splat_ply(
    splats: Splats,
    path: Path | str,
    *,
    bands: int = FULL_BANDS,
    besides: Mapping[str, Tensor] | None = None,
) -> None:
    """Write the values as they are, bit by bit, with `shN` padded by zeros.

    Args:
        splats: What to write.
        path: The file to make.
        bands: How many higher bands of colour it has, no fewer than the splats; by default as
            many as INRIA's code demands, those of degree 3.
        besides: More columns by name, of float32, int32 or uint8, a number for each Gaussian.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    rest = _rest(3 * bands)
    names = (*MEANS, *NORMALS, *SH0, *rest, *OPACITY, *SCALES, *QUATS)
    blocks = {
        MEANS: splats.means,
        SH0: splats.sh0[:, 0],
        OPACITY: splats.opacities[:, None],
        SCALES: splats.scales,
        QUATS: splats.quats,
    }
    for channel in range(3):
        first = channel * bands
        blocks[rest[first : first + splats.shN.shape[1]]] = splats.shN[:, :, channel]
    rows = np.zeros((len(splats), len(names)), "<f4")  # one copy of it all, and no more
    for columns, values in blocks.items():
        if columns:
            first = names.index(columns[0])
            rows[:, first : first + len(columns)] = values.detach().float().cpu().numpy()
    table = rows.view(np.dtype([(name, "<f4") for name in names]))[:, 0]
    write_ply_table(_with_columns(table, besides) if besides else table, path)


def _with_columns(
    table: Shaped[np.ndarray, " N"], besides: Mapping[str, Tensor]
) -> Shaped[np.ndarray, " N"]:
    arrays = {name: values.cpu().numpy() for name, values in besides.items()}
    kinds = [(name, array.dtype.newbyteorder("<")) for name, array in arrays.items()]
    wider = np.empty(len(table), np.dtype([*table.dtype.descr, *kinds]))
    for name in table.dtype.names or ():
        wider[name] = table[name]
    for name, array in arrays.items():
        wider[name] = array
    return wider


def pad_bands(shN: Float[Tensor, "N _ 3"]) -> Float[Tensor, "N 15 3"]:
    """Higher colour bands of degree 3, those beyond the splats' own degree being 0."""
    missing = FULL_BANDS - shN.shape[1]
    return torch.nn.functional.pad(shN, (0, 0, 0, missing)) if missing else shN


def of_degree(splats: Splats, degree: int) -> Splats:
    """The splats with the bands of a degree: higher ones are left out, missing ones are 0."""
    padded = pad_bands(splats.shN)
    return replace(splats, shN=padded[:, : (degree + 1) ** 2 - 1])


def needed_degree(splats: Splats) -> int:
    """The lowest degree of colour bands that leaves out zeros only."""
    used = splats.shN.ne(0).any(dim=2).any(dim=0).nonzero()
    return math.isqrt(int(used.max()) + 1) if len(used) else 0


def _rest(count: int) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(count))


def _find_rest(table: Shaped[np.ndarray, " N"], path: Path | str) -> tuple[str, ...]:
    """Names of the higher bands' columns, having checked that all columns are there."""
    names = table.dtype.names or ()
    rest = _rest(sum(name.startswith("f_rest_") for name in names))
    missing = [n for n in (*MEANS, *SH0, *OPACITY, *SCALES, *QUATS, *rest) if n not in names]
    if missing:
        raise StyleSplatError(
            f"Cannot read {path} as splats: it has no column {missing[0]}. "
            "Export it as an uncompressed 3DGS PLY."
        )
    if len(rest) not in REST_COUNTS:
        raise StyleSplatError(
            f"Cannot read {path} as splats: {len(rest)} f_rest columns fit no degree up to 3. "
            "Export it as an uncompressed 3DGS PLY."
        )
    return rest


def _columns(table: Shaped[np.ndarray, " N"], names: tuple[str, ...]) -> Float[Tensor, "N D"]:
    values = np.empty((len(table), len(names)), np.float32)
    for i, name in enumerate(names):
        values[:, i] = table[name]
    return torch.from_numpy(values)

"""Splats as PLY files with exactly the columns of the INRIA code, which every viewer opens."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.ply import AT_ONCE, PlyRows, ply_rows, write_ply_rows
from stylesplat.io.tensors import GAUSSIANS, check_range
from stylesplat.scene.splats import Splats

FULL_BANDS = 15  # higher bands of spherical harmonics at degree 3
REST_COUNTS = (0, 3 * 3, 3 * 8, 3 * FULL_BANDS)  # columns at each degree
MEANS = ("x", "y", "z")
SH0 = tuple(f"f_dc_{i}" for i in range(3))
OPACITY = ("opacity",)
SCALES = tuple(f"scale_{i}" for i in range(3))
QUATS = tuple(f"rot_{i}" for i in range(4))
REMEDY = "Remove those Gaussians, or make the file again."
SMALLEST_QUAT = 1e-10  # of a component: squares of less vanish in float32
NORMALS = ("nx", "ny", "nz")  # always 0; some viewers count on them


def read_splat_ply(path: Path | str, *, bands: bool = True) -> Splats:
    """Read splats of degree 0 to 3, their columns in any order; other columns are ignored.

    Without `bands` the higher bands of colour, three quarters of the file, are skipped.
    """
    with ply_rows(path, at_once=AT_ONCE) as rows:
        rest = _find_rest(rows.dtype, path)
        rest = rest if bands else ()
        count, own = rows.count, len(rest) // 3
        groups = (MEANS, QUATS, SCALES, OPACITY, SH0)
        arrays = [np.empty((count, len(names)), np.float32) for names in groups]
        higher = np.empty((count, own, 3), np.float32)
        targets = {
            name: array[:, i]
            for names, array in zip(groups, arrays, strict=True)
            for i, name in enumerate(names)
        }
        targets |= {name: higher[:, i % own, i // own] for i, name in enumerate(rest)}
        first = 0
        for block in rows.blocks:
            for name, target in targets.items():
                target[first : first + len(block)] = block[name]
            first += len(block)
    means, quats, scales, opacities, sh0 = map(torch.from_numpy, arrays)
    shN = torch.from_numpy(higher)
    return check_splats(Splats(means, quats, scales, opacities[:, 0], sh0[:, None], shN), path)


def check_splats(splats: Splats, path: Path | str) -> Splats:
    """Return the splats of a file; raise a StyleSplatError if `splat_fault` finds one."""
    fault = splat_fault(splats)
    if fault:
        raise StyleSplatError(f"Cannot read {path} as splats: {fault}. {REMEDY}")
    return splats


def splat_fault(splats: Splats) -> str | None:
    """Why these are no splats: a number is not finite or out of range, or a quaternion is 0."""
    try:
        for name, declared in GAUSSIANS.items():
            check_range(name, getattr(splats, name), declared)
    except ValueError as error:
        return str(error)
    unturned = int((splats.quats.abs() < SMALLEST_QUAT).all(dim=1).sum())
    return f"the rotations of {unturned} Gaussians are 0" if unturned else None


def write_splat_ply(
    splats: Splats,
    path: Path | str,
    *,
    bands: int = FULL_BANDS,
    besides: Mapping[str, Tensor] | None = None,
) -> None:
    """Write the values bit by bit, with `shN` padded by zeros to `bands` bands.

    INRIA's code demands those of degree 3. `besides` holds more columns by name, of float32, int32
    or uint8.
    """
    rest = _rest(3 * bands)
    names = (*MEANS, *NORMALS, *SH0, *rest, *OPACITY, *SCALES, *QUATS)
    more = {name: values.cpu().numpy() for name, values in (besides or {}).items()}
    kinds = [(name, array.dtype.newbyteorder("<")) for name, array in more.items()]
    dtype = np.dtype([*((name, "<f4") for name in names), *kinds])

    def blocks() -> Iterator[Shaped[np.ndarray, " B"]]:
        for start in range(0, len(splats), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            table = np.zeros(min(AT_ONCE, len(splats) - start), dtype)
            for name, values in _columns(splats, part, rest).items():
                table[name] = values
            for name, array in more.items():
                table[name] = array[part]
            yield table

    write_ply_rows(PlyRows(len(splats), dtype, blocks()), path)


def _columns(
    splats: Splats, part: slice, rest: Sequence[str]
) -> Mapping[str, Float[np.ndarray, " B"]]:
    """The columns of some rows, by name; of `rest` as many as the splats have bands."""
    bands, own = len(rest) // 3, splats.shN.shape[1]
    blocks = (
        (MEANS, splats.means[part]),
        (SH0, splats.sh0[part, 0]),
        (OPACITY, splats.opacities[part, None]),
        (SCALES, splats.scales[part]),
        (QUATS, splats.quats[part]),
        *((rest[c * bands : c * bands + own], splats.shN[part, :, c]) for c in range(3)),
    )
    arrays = ((names, values.detach().float().cpu().numpy()) for names, values in blocks)
    return {name: array[:, i] for names, array in arrays for i, name in enumerate(names)}


def pad_bands(shN: Float[Tensor, "N _ 3"]) -> Float[Tensor, "N 15 3"]:
    """Higher bands of degree 3: missing ones are 0."""
    missing = FULL_BANDS - shN.shape[1]
    return torch.nn.functional.pad(shN, (0, 0, 0, missing)) if missing else shN


def of_degree(splats: Splats, degree: int) -> Splats:
    """The splats with the bands of a degree: higher ones are dropped, missing ones are 0."""
    padded = pad_bands(splats.shN)
    return replace(splats, shN=padded[:, : (degree + 1) ** 2 - 1])


def needed_degree(splats: Splats) -> int:
    """The lowest degree that drops only zeros."""
    used = splats.shN.ne(0).any(dim=2).any(dim=0).nonzero()
    return math.isqrt(int(used.max()) + 1) if len(used) else 0


def _rest(count: int) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(count))


def _find_rest(dtype: np.dtype, path: Path | str) -> tuple[str, ...]:
    """The columns of the higher bands; a missing column is a StyleSplatError."""
    names = dtype.names or ()
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

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
from stylesplat.io.ply import read_ply_table, write_ply_rows
from stylesplat.io.tensors import GAUSSIANS, check_range
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import ORIGIN, to_world

FULL_BANDS = 15  # higher bands of spherical harmonics at degree 3
BANDS = (0, 3, 8, FULL_BANDS)  # at each degree
MEANS, NORMALS = ("x", "y", "z"), ("nx", "ny", "nz")  # normals are 0; some viewers count on them
SH0, SCALES = (tuple(f"{name}_{i}" for i in range(3)) for name in ("f_dc", "scale"))
OPACITY, QUATS = ("opacity",), tuple(f"rot_{i}" for i in range(4))
AT_ONCE = 1 << 11  # rows: half a MB, which stays in the cache while columns are copied
REMEDY = "Remove those Gaussians, or make the file again."
SMALLEST_QUAT = 1e-10  # of a component: squares of less vanish in float32


def read_splat_ply(path: Path | str) -> Splats:
    """Read splats of degree 0 to 3, their columns in any order; other columns are ignored.

    Positions have 64 bits if those of the file have more than 32.
    """
    table = read_ply_table(path)
    rest = _find_rest(table.dtype, path)
    shapes = ((3,), (4,), (3,), (), (1, 3), (len(rest) // 3, 3))
    means, quats, scales, opacities, sh0, shN = (torch.empty(len(table), *s) for s in shapes)
    if not all(np.can_cast(table.dtype[name], np.float32) for name in MEANS):
        means = means.double()
    splats = Splats(means, quats, scales, opacities, sh0, shN)
    columns = _columns(splats, rest)
    for start in range(0, len(table), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        for name, column in columns.items():
            column[part] = table[part][name]
    return check_splats(splats, path)


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


def refuse_faulty(splats: Splats, path: Path) -> None:
    """Raise a StyleSplatError if splats cannot be exported to a file."""
    fault = splat_fault(splats) if len(splats) else None
    if fault:
        raise StyleSplatError(f"Cannot export to {path}: {fault}. {REMEDY}")


def write_splat_ply(
    splats: Splats,
    path: Path | str,
    *,
    bands: int = FULL_BANDS,
    besides: Mapping[str, Tensor] | None = None,
    in_world: bool = False,
) -> None:
    """Write the values bit by bit, with `shN` padded by zeros to `bands` bands.

    INRIA's code demands those of degree 3. `besides` holds more columns by name, of float32, int32
    or uint8. Positions are relative to the world's offset; with `in_world` they are in the world,
    as doubles if there is an offset.
    """
    rest = _rest(3 * bands)
    names = (*MEANS, *NORMALS, *SH0, *rest, *OPACITY, *SCALES, *QUATS)
    more = {name: values.cpu().numpy() for name, values in (besides or {}).items()}
    kinds = [(name, array.dtype.newbyteorder("<")) for name, array in more.items()]
    doubles = MEANS if in_world and splats.world_offset != ORIGIN else ()
    numbers = [(name, "<f8" if name in doubles else "<f4") for name in names]
    dtype = np.dtype([*numbers, *kinds])

    def blocks() -> Iterator[Shaped[np.ndarray, " B"]]:
        for start in range(0, len(splats), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            some = splats[part].map(lambda tensor: tensor.detach().float().cpu())
            table = np.zeros(len(some), dtype)
            for name, values in _columns(some, rest).items():
                table[name] = values
            for axis, name in enumerate(doubles):
                table[name] = to_world(some.means, splats.world_offset)[:, axis].numpy()
            for name, array in more.items():
                table[name] = array[part]
            yield table

    write_ply_rows(path, len(splats), dtype, blocks())


def _columns(splats: Splats, rest: Sequence[str]) -> dict[str, Float[np.ndarray, " N"]]:
    """Views of splats on the CPU by column; of `rest` as many as the splats have bands."""
    bands, own = len(rest) // 3, splats.shN.shape[1]
    groups = (
        (MEANS, splats.means),
        (SH0, splats.sh0[:, 0]),
        (OPACITY, splats.opacities[:, None]),
        (SCALES, splats.scales),
        (QUATS, splats.quats),
        *((rest[c * bands : c * bands + own], splats.shN[:, :, c]) for c in range(3)),
    )
    return {name: values.numpy()[:, i] for names, values in groups for i, name in enumerate(names)}


def pad_bands(shN: Float[Tensor, "N _ 3"]) -> Float[Tensor, "N 15 3"]:
    """Higher bands of degree 3: missing ones are 0."""
    missing = FULL_BANDS - shN.shape[1]
    return torch.nn.functional.pad(shN, (0, 0, 0, missing)) if missing else shN


def of_degree(splats: Splats, degree: int) -> Splats:
    """The splats with the bands of a degree: higher ones are dropped, missing ones are 0."""
    return replace(splats, shN=pad_bands(splats.shN)[:, : BANDS[degree]])


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
    fault = f"it has no column {missing[0]}" if missing else None
    if len(rest) not in [3 * bands for bands in BANDS]:
        fault = fault or f"{len(rest)} f_rest columns fit no degree up to 3"
    if fault:
        raise StyleSplatError(
            f"Cannot read {path} as splats: {fault}. Export it as an uncompressed 3DGS PLY."
        )
    return rest

"""Splats as PLY files with exactly the columns of the INRIA code, which every viewer opens."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError, join_names, shorten
from stylesplat.io.gaussian_lists import LABEL_NAMES, STATE
from stylesplat.io.ply import VERTEX, PlyHeader, Table, read_ply, write_ply_rows
from stylesplat.io.tensors import GAUSSIANS, check_range
from stylesplat.progress import say
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.scene.world_offset import ORIGIN, to_world

FULL_BANDS = 15  # higher bands of spherical harmonics at degree 3
BANDS = (0, 3, 8, FULL_BANDS)  # at each degree
MAX_DEGREE = len(BANDS) - 1
MEANS, NORMALS = ("x", "y", "z"), ("nx", "ny", "nz")  # normals are 0; some viewers count on them
SH0, SCALES = (tuple(f"{name}_{i}" for i in range(3)) for name in ("f_dc", "scale"))
OPACITY, QUATS = ("opacity",), tuple(f"rot_{i}" for i in range(4))
REST, RGB = "f_rest_", ("red", "green", "blue")
FILTER = "filter_3D"  # Mip-Splatting's: the standard deviation of a blur of each Gaussian
HARMLESS = ("alpha", STATE, *LABEL_NAMES)  # beside plain colours; what `import --labels` reads
SPLAT_PLY_HALF = 2  # bytes
THICKNESS_2D = 1e-6  # of 2D Gaussians, as 2DGS' authors have it
PLAIN, ANTIALIASED, TWO_D = "default", "mip", "2dgs"  # modes of Brush and splat-transform
MARK = f"SplatRenderMode: {ANTIALIASED}"
RENDER_MODE = re.compile(r"SplatRenderMode\s*[:=]?\s*(\S+)", re.IGNORECASE)
ANTIALIAS = re.compile(r"antialias(?:ed|ing)?\s*[:=]?\s*(0|1|true|false)$", re.IGNORECASE)
VERTICAL = re.compile(r"vertical\s*axis\s*[:=]?\s*([+-]?)([xyz])\b", re.IGNORECASE)
SPLAT_PLY_AT_ONCE = 1 << 11  # rows: half a MB, which stays in the cache while columns are copied
SPLAT_PLY_REMEDY = "Remove those Gaussians, or make the file again."
SMALLEST_QUAT = 1e-10  # of a component: squares of less vanish in float32


def read_splat_ply(path: Path | str) -> Splats:
    """Read splats that we wrote ourselves: what `splat_fault` finds is a StyleSplatError."""
    splats = parse_splat_ply(path)
    if fault := splat_fault(splats):
        raise StyleSplatError(f"Cannot read {path} as splats: {fault}. {SPLAT_PLY_REMEDY}")
    return splats


def parse_splat_ply(path: Path | str) -> Splats:
    """Read splats of any program, their columns in any order, their numbers as they are.

    Positions have 64 bits if those of the file have more than 32. Colours may be plain `red green
    blue`, numbers half floats in columns of 16 bits, the thickness of 2D Gaussians missing. A line
    names what is read in another way than it stands there, and what is left out.
    """
    header, tables = read_ply(path)
    table = _with_half_floats(tables[VERTEX])
    names = table.dtype.names or ()
    rest = _find_rest(table.dtype, path)
    bands = min(len(rest) // 3, FULL_BANDS)
    shapes = ((3,), (4,), (3,), (), (1, 3), (bands, 3))
    means, quats, scales, opacities, sh0, shN = (torch.empty(len(table), *s) for s in shapes)
    if not all(np.can_cast(table.dtype[name], np.float32) for name in MEANS):
        means = means.double()
    splats = Splats(means, quats, scales, opacities, sh0, shN)
    columns = {name: each for name, each in _columns(splats, rest).items() if name in names}
    with np.errstate(all="ignore"):  # doubles that are too large; `drawable` finds them
        for start in range(0, len(table), SPLAT_PLY_AT_ONCE):
            part = slice(start, start + SPLAT_PLY_AT_ONCE)
            for name, column in columns.items():
                column[part] = table[part][name]
    if SH0[0] not in names:
        sh0[:] = sh0_from_rgb(_plain_colors(table))[:, None]
    if SCALES[2] not in names:
        scales[:, 2] = math.log(THICKNESS_2D)
        say(f"{path} has no {SCALES[2]}: its Gaussians are flat, as those of 2DGS.")
    if FILTER in names:
        splats = _filtered(splats, torch.from_numpy(np.array(table[FILTER], np.float64)))
        say(f"{path} has a {FILTER}: scales and opacities are what Mip-Splatting makes of it.")
    _say_what_is_left_out(path, header, names, rest)
    return replace(splats, antialiased=is_antialiased(path, header.comments))


def vertical_axis(comments: Sequence[str]) -> str | None:
    """The direction that the comments of a PLY file call up, such as 'z' or '-y'.

    nerfstudio writes z for its world, whose z points up. Brush writes y for COLMAP's, whose y
    points down: without a sign, y is taken so.
    """
    found = [match for each in comments if (match := VERTICAL.match(each))]
    if not found:
        return None
    sign, axis = found[-1].groups()
    return f"{'-' if sign == '-' or (axis.lower() == 'y' and not sign) else ''}{axis.lower()}"


def _with_half_floats(table: Table) -> Table:
    """The table with splats' columns of 16 bits as what they can only be, half floats."""
    dtype, names = table.dtype, table.dtype.names or ()
    ours = {*MEANS, *SH0, *OPACITY, *SCALES, *QUATS, FILTER}
    if MEANS[0] in names and dtype[MEANS[0]].itemsize == SPLAT_PLY_HALF:
        ours |= {*RGB}
    halves = {
        name: f"{dtype[name].byteorder}f2"
        for name in names
        if (name in ours or name.startswith(REST)) and dtype[name].itemsize == SPLAT_PLY_HALF
    }
    kinds = [(name, halves.get(name, dtype[name])) for name in names]
    return table.view(np.dtype(kinds)) if halves else table


def _plain_colors(table: Table) -> Float[Tensor, "N 3"]:
    """Colours from 0 to 1 of columns red, green and blue: floats, or integers up to 255."""
    kind = table.dtype[RGB[0]]
    whole = 1 if kind.kind == "f" else 65535 if kind.itemsize == SPLAT_PLY_HALF else 255
    columns = [np.array(table[name], np.float64) / whole for name in RGB]
    return torch.from_numpy(np.stack(columns, axis=1)).float()


def _filtered(splats: Splats, sizes: Float[Tensor, " N"]) -> Splats:
    """Mip-Splatting's 3D filter (Yu et al. 2024): a blur of a size, opacity spread over it."""
    scales = splats.scales.double()
    blurred = torch.logaddexp(2 * scales, 2 * sizes.log()[:, None]) / 2
    shares = torch.where(blurred == scales, 0.0, scales - blurred)  # no filter, perhaps no scale
    alphas = splats.opacities.double().sigmoid() * shares.sum(dim=1).exp()
    return replace(splats, scales=blurred.float(), opacities=alphas.logit().float())


def _say_what_is_left_out(
    path: Path | str, header: PlyHeader, names: Sequence[str], rest: Sequence[str]
) -> None:
    if len(rest) > 3 * FULL_BANDS:
        degree = math.isqrt(len(rest) // 3)
        say(f"{path} has colours of degree {degree}: the bands above 3 are left out.")
    known = {*MEANS, *NORMALS, *SH0, *RGB, *rest, *OPACITY, *SCALES, *QUATS, FILTER, *HARMLESS}
    columns = [name for name in names if name not in known]
    elements = [each.name for each in header.elements if each.rows and each.name != VERTEX]
    for what, found in (("columns", columns), ("elements", elements)):
        if found:
            say(f"{path} has {what} that splats do not have, left out: {join_names(found)}.")


def is_antialiased(path: Path | str, comments: Sequence[str]) -> bool:
    """Whether the last comment about it, Brush's or Postshot's, wants an anti-aliased rendering."""
    mode = PLAIN
    for comment in comments:
        if match := RENDER_MODE.match(comment):
            mode = match[1].lower()
        elif match := ANTIALIAS.match(comment):
            mode = ANTIALIASED if match[1].lower() in ("1", "true") else PLAIN
    if mode not in (PLAIN, ANTIALIASED, TWO_D):
        say(f"{path} asks for the render mode {shorten(mode)!r}, which is unknown: left out.")
    return mode == ANTIALIASED


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
        raise StyleSplatError(f"Cannot export to {path}: {fault}. {SPLAT_PLY_REMEDY}")


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
        for start in range(0, len(splats), SPLAT_PLY_AT_ONCE):
            part = slice(start, start + SPLAT_PLY_AT_ONCE)
            some = splats[part].map(lambda tensor: tensor.detach().float().cpu())
            table = np.zeros(len(some), dtype)
            for name, values in _columns(some, rest).items():
                table[name] = values
            for axis, name in enumerate(doubles):
                table[name] = to_world(some.means, splats.world_offset)[:, axis].numpy()
            for name, array in more.items():
                table[name] = array[part]
            yield table

    comments = [MARK] if splats.antialiased else []
    write_ply_rows(path, len(splats), dtype, blocks(), comments=comments)


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


def joined(parts: Sequence[Splats]) -> Splats:
    """Splats of any degrees as one; a ValueError if there are no parts."""
    if not parts:
        raise ValueError("it has no part with Gaussians")
    degree = max(part.sh_degree for part in parts)
    return Splats.cat([of_degree(part, degree) for part in parts])


def needed_degree(splats: Splats) -> int:
    """The lowest degree that drops only zeros."""
    used = splats.shN.ne(0).any(dim=2).any(dim=0).nonzero()
    return math.isqrt(int(used.max()) + 1) if len(used) else 0


def _rest(count: int) -> tuple[str, ...]:
    return tuple(f"{REST}{i}" for i in range(count))


def _find_rest(dtype: np.dtype, path: Path | str) -> tuple[str, ...]:
    """The columns of the higher bands; a missing column is a StyleSplatError."""
    names = dtype.names or ()
    rest = _rest(sum(name.startswith(REST) for name in names))
    colors = SH0 if SH0[0] in names or not set(RGB) <= {*names} else RGB
    needed = (*MEANS, *colors, *OPACITY, *SCALES[:2], *QUATS, *rest)
    missing = [name for name in needed if name not in names]
    fault = f"it has no column {missing[0]}" if missing else None
    if {*OPACITY, *SCALES[:2], *QUATS} <= {*missing}:
        fault = f"it is a cloud of points or a mesh, without Gaussians ({join_names(names)})"
    bases = len(rest) // 3 + 1
    if len(rest) % 3 or math.isqrt(bases) ** 2 != bases:
        fault = fault or f"{len(rest)} f_rest columns fit no degree"
    coded = [name for name in needed if name in names and dtype[name].itemsize == 1]
    if {*coded} - {*RGB}:
        fault = fault or f"its column {coded[0]} has 8 bits, which a codebook would explain"
    if fault:
        raise StyleSplatError(
            f"Cannot read {path} as splats: {fault}. Export it as an uncompressed 3DGS PLY."
        )
    return rest

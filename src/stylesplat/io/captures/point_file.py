"""The sparse points that transforms.json names: a PLY of positions, with colours in many forms."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Shaped, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.posed_files import finite_points
from stylesplat.io.files import is_there
from stylesplat.io.ply import read_ply_table
from stylesplat.progress import say
from stylesplat.scene.splats import rgb_from_sh0

XYZ = ("x", "y", "z")
RGB = ("red", "green", "blue")
OTHER_RGB = (("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
SH0 = ("f_dc_0", "f_dc_1", "f_dc_2")  # of a file of splats
GREY = 128
DEEP = 257  # 16-bit colours over 8-bit ones


class SparsePoints(NamedTuple):
    means: Float[Tensor, "M 3"]
    """64 bits."""
    colors: UInt8[Tensor, "M 3"]


def read_points(path: Path) -> SparsePoints | None:
    """Read points; what is missing or no number is left out, with a line.

    Colours are bytes, 16-bit integers, or floats of 0..1 or 0..255; without any, points are grey.
    """
    if not is_there(path):
        say(f"The file of points {path} is not there: training starts from random points.")
        return None
    table = read_ply_table(path)
    columns = {name.lower(): name for name in table.dtype.names or ()}
    missing = {*XYZ} - columns.keys()
    if missing:
        raise StyleSplatError(
            f"The points {path} have no column {min(missing)}. Write them again, as a PLY of "
            "vertices."
        )
    means = np.stack([table[columns[name]].astype(np.float64) for name in XYZ], axis=1)
    finite = finite_points(torch.from_numpy(means), path).numpy()
    colors = _colors(table, columns)
    if colors is None:
        say(f"The points in {path} have no colours, so they start grey.")
        colors = np.full(means.shape, GREY, np.uint8)
    means, colors = (torch.from_numpy(each[finite]) for each in (means, colors))
    return SparsePoints(means, colors) if len(means) else None


def _colors(
    table: Shaped[np.ndarray, " M"], columns: dict[str, str]
) -> UInt8[np.ndarray, "M 3"] | None:
    names = next((each for each in (RGB, *OTHER_RGB, SH0) if columns.keys() >= {*each}), None)
    if names is None:
        return None
    values = np.stack([table[columns[name]].astype(np.float64) for name in names], axis=1)
    values[~np.isfinite(values)] = 0.0 if names is SH0 else np.nan
    if names is SH0:
        values = 255 * rgb_from_sh0(torch.from_numpy(values)).numpy()
    elif all(table.dtype[columns[name]].kind == "f" for name in names):
        values *= 255 if np.nanmax(values, initial=0) <= 1 else 1
    elif np.nanmax(values, initial=0) > 255:
        values /= DEEP
    return np.nan_to_num(values, nan=GREY).round().clip(0, 255).astype(np.uint8)

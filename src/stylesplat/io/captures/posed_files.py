"""What the readers of COLMAP and transforms.json share, and the points beside the latter."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import torch
from jaxtyping import Bool, Float, Shaped, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, join_names, shorten
from stylesplat.io.captures.lens import Lens
from stylesplat.io.files import is_there
from stylesplat.io.json_yaml import JSON_MAX_NAME
from stylesplat.io.ply import read_ply_table
from stylesplat.io.splats.splat_ply import RGB, SH0
from stylesplat.progress import say
from stylesplat.scene.cameras import are_rigid
from stylesplat.scene.splats import rgb_from_sh0
from stylesplat.scene.world_offset import ORIGIN, Offset, choose_offset, from_world

# Bytes of a file's or folder's name: systems take 255, and a draft's name has 14 more
MAX_PART = 240
UNUSABLE = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")  # control characters, and no UTF-8


@dataclass(frozen=True, eq=False)
class PosedFiles:
    """Posed photos as a capture's files describe them; no photo has been opened.

    Label maps and views are written under the photos' names, so a name that leaves its folder, that
    no file can have or that occurs twice is a StyleSplatError.
    """

    names: tuple[str, ...]
    """Of the photos, within their common folder."""
    paths: tuple[Path, ...]
    lenses: tuple[Lens | None, ...]
    """None where the lens depends on a photo that does not exist."""
    viewmats: Float[Tensor, "C 4 4"]
    """World to camera, OpenCV axes, as read: 64 bits, not checked."""
    points: Float[Tensor, "M 3"] | None
    """In the world, 64 bits."""
    point_colors: UInt8[Tensor, "M 3"] | None
    masks: tuple[Path | None, ...] | None = None
    """Pictures that are 0 where a photo's pixels are not to be used; None for a photo without."""
    held_out: frozenset[str] | None = None
    """Names of the photos that the files hold out of training; None if they say nothing."""
    missing: tuple[str, ...] = ()
    """Names of further photos with poses, which are nowhere in the capture."""

    def __post_init__(self) -> None:
        for name in self.names:
            check_path(name)
            if leaves(name):
                raise StyleSplatError(
                    f"The photo {shorten(name)!r} has a name that leaves the folder of the photos. "
                    "Pose the photos again, under names without '..' that are not absolute."
                )
        for name, count in Counter(map(PurePosixPath, self.names)).items():
            if count > 1:
                raise StyleSplatError(
                    f"The photo {shorten(str(name))!r} is posed {count} times. Keep one of its "
                    "poses."
                )


def split_offset(posed: PosedFiles) -> tuple[PosedFiles, Offset]:
    """The poses, and points in 32 bits, relative to an offset of the world; and the offset."""
    viewmats, points = posed.viewmats, posed.points
    positions = -torch.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])
    offset = choose_offset(positions if points is None else torch.cat([positions, points]))
    if points is not None:
        points = from_world(points, offset).float()
    if offset != ORIGIN:
        viewmats = viewmats.clone()
        viewmats[:, :3, 3] += viewmats[:, :3, :3] @ viewmats.new_tensor(offset)
    return replace(posed, viewmats=viewmats, points=points), offset


def drop_missing(posed: PosedFiles, folder: Path) -> PosedFiles:
    """Leave out photos whose files do not exist, with a message.

    So are photos whose masks do not exist: what these mask is not to be used. It is an error if
    more than half of the photos to train on are left out.
    """
    posed = _keep_existing(posed, folder, posed.paths, posed.names, "photos that have poses")
    masks = posed.masks or ()
    names = [str(path and Path(os.path.relpath(path, folder)).as_posix()) for path in masks]
    return _keep_existing(posed, folder, masks, names, "photos that have masks") if masks else posed


def _keep_existing(
    posed: PosedFiles, folder: Path, paths: Sequence[Path | None], names: Sequence[str], photos: str
) -> PosedFiles:
    # Unlike Path's, lexists takes any name
    there = [path is None or os.path.lexists(path) for path in paths]
    missing = [name for name, found in zip(names, there, strict=True) if not found]
    missing += posed.missing
    if not missing:
        return posed
    held_out, count = posed.held_out or frozenset(), sum(path is not None for path in paths)
    count += len(posed.missing)
    pairs = zip(posed.names, there, strict=True)
    to_train = [found for name, found in pairs if name not in held_out]
    if 2 * sum(to_train) < len(to_train) + len(posed.missing):
        raise StyleSplatError(
            f"Only {count - len(missing)} of the {count} {photos} in {folder} are there. "
            f"Missing: {join_names(missing)}. Put them back, or pose the photos again."
        )
    of = f"{len(missing)} of the {count} {photos} in {folder}"
    say(f"Missing, so left out: {join_names(missing)} ({of}).")
    return replace(_only(posed, there), missing=())


def drop_bad_poses(posed: PosedFiles, folder: Path) -> PosedFiles:
    """Leave out poses that are none, with a message; more than half are an error."""
    good = are_rigid(posed.viewmats).tolist()
    bad = [name for name, fits in zip(posed.names, good, strict=True) if not fits]
    if not bad:
        return posed
    said = f"{len(bad)} of the {len(good)} poses in {folder} are NaN or no rotation and shift"
    if 2 * len(bad) > len(good):
        raise StyleSplatError(f"{said}, the first that of {bad[0]}. Pose the photos again.")
    say(f"{said}, so left out: {join_names(bad)}.")
    return _only(posed, good)


def finite_points(points: Float[Tensor, "M 3"], place: Path) -> Bool[Tensor, " M"]:
    """Which points are somewhere; a message tells how many are not."""
    good = points.float().isfinite().all(dim=1)
    if not good.all():
        say(
            f"{int((~good).sum()):,} of the {len(good):,} points in {place} are NaN or infinitely "
            "far, so left out."
        )
    return good


def drop_bad_points(posed: PosedFiles, folder: Path) -> PosedFiles:
    """Leave out points that are nowhere, with a message."""
    if posed.points is None:
        return posed
    good = finite_points(posed.points, folder)
    colors = posed.point_colors
    return replace(
        posed, points=posed.points[good], point_colors=None if colors is None else colors[good]
    )


def _only(posed: PosedFiles, kept: Sequence[bool]) -> PosedFiles:
    columns = zip(posed.names, posed.paths, posed.lenses, strict=True)
    names, paths, lenses = zip(*compress(columns, kept), strict=True)
    return replace(
        posed,
        names=names,
        paths=paths,
        lenses=lenses,
        viewmats=posed.viewmats[torch.tensor(kept)],
        masks=None if posed.masks is None else (*compress(posed.masks, kept),),
        held_out=(posed.held_out or frozenset()) & {*names} or None,
    )


def check_path(text: str) -> None:
    encoded = text.encode(errors="surrogatepass")
    too_long = len(encoded) > JSON_MAX_NAME or max(map(len, encoded.split(b"/"))) > MAX_PART
    if too_long or UNUSABLE.search(text):
        fault = "is too long for a file" if too_long else "has characters that no file name has"
        raise StyleSplatError(
            f"The photo's name {shorten(text)!r} {fault}. Rename the photo, and pose again."
        )


def leaves(name: str) -> bool:
    """Whether a name leaves its folder, or names the folder itself, on any system."""
    windows = PureWindowsPath(name)
    return bool(
        windows.drive or windows.root or ".." in windows.parts or not PurePosixPath(name).name
    )


XYZ = ("x", "y", "z")
OTHER_RGB = (("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
POSED_GREY = 128
DEEP = 257  # 16-bit colours over 8-bit ones


SparsePoints = tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]] | tuple[None, None]
"""Positions, of 64 bits, and colours, if there are any points."""


def read_points(path: Path) -> SparsePoints:
    """Read points; what is missing or no number is left out, with a line.

    Colours are bytes, 16-bit integers, or floats of 0..1 or 0..255; without any, points are grey.
    """
    if not is_there(path):
        say(f"The file of points {path} is not there: training starts from random points.")
        return None, None
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
        colors = np.full(means.shape, POSED_GREY, np.uint8)
    means, colors = (torch.from_numpy(each[finite]) for each in (means, colors))
    return (means, colors) if len(means) else (None, None)


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
    return np.nan_to_num(values, nan=POSED_GREY).round().clip(0, 255).astype(np.uint8)

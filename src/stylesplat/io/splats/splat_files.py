"""Any file of splats, read and written."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.atomic import refuse_file
from stylesplat.io.files import is_there, read_bytes, reading
from stylesplat.io.kinds import SOG_META, wrong_kind
from stylesplat.io.ply import MAX_HEADER
from stylesplat.io.splats.compressed_ply import (
    is_compressed,
    read_compressed_ply,
    write_compressed_ply,
)
from stylesplat.io.splats.dot_splat import dot_splat_order, read_dot_splat, write_dot_splat
from stylesplat.io.splats.gltf import VERSION_INSIDE, read_gltf, write_glb, write_gltf
from stylesplat.io.splats.ksplat import read_ksplat
from stylesplat.io.splats.packing import morton_order
from stylesplat.io.splats.sog import read_sog, write_sog
from stylesplat.io.splats.splat_ply import (
    check_splats,
    needed_degree,
    of_degree,
    read_splat_ply,
    write_splat_ply,
)
from stylesplat.io.splats.spz import read_spz, write_spz
from stylesplat.progress import say
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import ORIGIN, announced, choose_offset, offset_text

COMPRESSED = ".compressed.ply"  # what SuperSplat calls its own
WRITERS: dict[str, Callable[[Splats, Path], None]] = {  # of all formats but plain PLY
    COMPRESSED: write_compressed_ply,
    ".spz": write_spz,
    ".splat": write_dot_splat,
    ".sog": write_sog,
    ".glb": write_glb,
    ".gltf": write_gltf,
}
SPZ_INSIDE = {".glb": write_glb, ".gltf": write_gltf}  # if a version of SPZ is asked for
MAX_DEGREE = 3
WITH_OFFSET = (".ply", ".glb", ".gltf")  # formats that hold coordinates in 64 bits


def _read_ply(path: Path) -> Splats:
    if is_compressed(read_bytes(path, first=MAX_HEADER)):
        return read_compressed_ply(read_bytes(path))
    return read_splat_ply(path)


# They raise any error for damaged content; `read_splats` names the file, and checks the numbers.
# Positions are in the world, with 64 bits where the file may have more than 32.
READERS: dict[str, Callable[[Path], Splats]] = {
    ".ply": _read_ply,
    ".spz": read_spz,
    ".splat": read_dot_splat,
    ".ksplat": read_ksplat,
    ".sog": read_sog,
    ".glb": read_gltf,
    ".gltf": read_gltf,
}


def read_splats(path: Path | str) -> Splats:
    """Read splats as other programs write them, in the world frame of their file.

    Where its coordinates are too large for float32 they get a `world_offset`, and a line says so.

    PLY as INRIA, gsplat, nerfstudio and Postshot write it, SuperSplat's compressed PLY, SPZ,
    .splat, .ksplat, glTF, and SOG, as a bundle or as the meta.json of a folder. No memory is
    allocated for a count that was not checked against the file.
    """
    path = Path(path)
    reader = read_sog if path.name == SOG_META else READERS.get(path.suffix.lower())
    if reader is None or path.is_dir() or not is_there(path):
        raise wrong_kind(path, "splat")
    with reading(path, "Export it again.", what=" as splats"):
        splats = check_splats(_in_32_bits(reader(path), path), path)
    if not len(splats):
        raise StyleSplatError(f"There are no Gaussians in {path}. Choose another file.")
    return splats


def _in_32_bits(splats: Splats, path: Path) -> Splats:
    """Splats as read, relative to an offset of the world if they need one."""
    offset = choose_offset(splats.means)
    if offset != ORIGIN:
        coarse = ""
        if splats.means.dtype == torch.float32:
            step = np.spacing(np.float32(max(map(abs, offset))))
            coarse = f" The file's own float32 has rounded its coordinates to {step:.2g}."
        say(announced(path, offset) + coarse)
    splats = splats.relative_to(offset)
    return replace(splats, means=splats.means.float())


def row_order(splats: Splats, path: Path | str) -> Int[Tensor, " N"]:
    """The Gaussian of each row when splats are written into a file of that name."""
    suffix = _suffix(Path(path))
    if suffix in (COMPRESSED, ".sog"):
        return morton_order(splats.means)
    return dot_splat_order(splats) if suffix == ".splat" else torch.arange(len(splats))


def write_splats(
    splats: Splats,
    path: Path | str,
    *,
    overwrite: bool = True,
    sh_degree: int | None = None,
    spz_version: int | None = None,
    besides: Mapping[str, Tensor] | None = None,
) -> None:
    """Write splats in the format that the file's suffix names; `export` describes the formats.

    Where there is a `world_offset`, `.ply`, as doubles, and glTF have the world's coordinates; the
    other formats have those relative to it, and a line says so.

    By default no band of colour is lost: `.ply` has the columns of degree 3, the others as many as
    are not all zero. `besides` holds more columns of a `.ply`, of float32, int32 or uint8.
    """
    path = Path(path)
    suffix = _suffix(path)
    if suffix not in (".ply", *WRITERS):
        raise StyleSplatError(
            f"Cannot export to {path}: unknown suffix {path.suffix!r}. "
            f"Use .ply, {', '.join(WRITERS)}, or .html for a page."
        )
    if sh_degree is not None:
        check_choice(sh_degree, "degree of colour", range(MAX_DEGREE + 1))
    if suffix == ".splat" and sh_degree:
        raise StyleSplatError(
            f"Cannot export to {path}: a .splat has one colour per Gaussian, which is degree 0. "
            "Leave the degree out, or choose a .ply or .spz."
        )
    if spz_version is not None and suffix not in SPZ_INSIDE and suffix != ".spz":
        raise StyleSplatError(f"{path} is no SPZ, so it has no version of SPZ. Leave it out.")
    if suffix in SPZ_INSIDE and spz_version not in (None, VERSION_INSIDE):
        raise StyleSplatError(
            f"Cannot export to {path}: glTF holds SPZ of version {VERSION_INSIDE}, not "
            f"{spz_version}. Take that, or choose a .spz."
        )
    if besides and suffix != ".ply":
        raise StyleSplatError(
            f"Cannot export to {path}: it has no more columns than its format says. Choose a .ply."
        )
    if not overwrite:
        refuse_file(path)
    splats = splats.detach().to("cpu")
    if sh_degree is None:
        sh_degree = MAX_DEGREE if suffix == ".ply" else needed_degree(splats)
    splats = of_degree(splats, sh_degree)
    if spz_version is not None and suffix == ".spz":
        write_spz(splats, path, version=spz_version)
    elif spz_version is not None:
        SPZ_INSIDE[suffix](splats, path, spz=True)
    elif suffix == ".ply":
        bands = splats.shN.shape[1]
        write_splat_ply(splats, path, bands=bands, besides=besides, in_world=True)
    else:
        WRITERS[suffix](splats, path)
    if suffix not in WITH_OFFSET:
        say_left_out(splats, path)


def say_left_out(splats: Splats, path: Path) -> None:
    """Say the offset of the world, if there is one, that a file cannot hold."""
    if splats.world_offset != ORIGIN:
        say(
            f"{path} has float32 coordinates, too coarse for this world: they are relative to "
            f"{offset_text(splats.world_offset)}. A .ply or .glb has the world's."
        )


def _suffix(path: Path) -> str:
    name = path.name.lower()
    return COMPRESSED if name.endswith(COMPRESSED) else path.suffix.lower()

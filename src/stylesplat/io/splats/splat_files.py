"""Any file of splats: told by its first bytes, read and written; what of it can be drawn."""

import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice, join_names, shorten
from stylesplat.io.atomic import refuse_file
from stylesplat.io.files import is_there, open_binary, read_bytes, reading
from stylesplat.io.kinds import (
    CHECKPOINTS,
    SOG_JSONS,
    SOG_LEVELS,
    SOG_META,
    SPLATS,
    USD,
    wrong_kind_error,
)
from stylesplat.io.ply import BOM, read_header
from stylesplat.io.ply import PLY_MAGIC as PLY
from stylesplat.io.splats.checkpoints import TORCH_LIST, read_checkpoint
from stylesplat.io.splats.compressed_ply import (
    is_compressed,
    read_compressed_ply,
    write_compressed_ply,
)
from stylesplat.io.splats.dot_splat import DOT_SPLAT_MAGIC as KSPLAT
from stylesplat.io.splats.dot_splat import (
    DOT_SPLAT_ROW,
    dot_splat_order,
    read_dot_splat,
    read_ksplat,
    write_dot_splat,
)
from stylesplat.io.splats.gltf import VERSION_INSIDE, read_gltf, write_glb, write_gltf
from stylesplat.io.splats.gltf_file import GLB_MAGIC as GLB
from stylesplat.io.splats.packing import PACKED_SMALLEST, morton_order
from stylesplat.io.splats.sog import ZIP, read_sog, read_streamed_sog, write_sog
from stylesplat.io.splats.splat_ply import (
    MAX_DEGREE,
    SMALLEST_QUAT,
    needed_degree,
    of_degree,
    parse_splat_ply,
    splat_fault,
    vertical_axis,
    write_splat_ply,
)
from stylesplat.io.splats.spz import MAGIC as SPZ
from stylesplat.io.splats.spz import read_spz, write_spz
from stylesplat.io.splats.usd import USD_BINARY, USD_INSIDE, USD_TEXT, read_usd, write_usd
from stylesplat.io.tensors import GAUSSIANS, LARGEST_LOG, LARGEST_POSITION, as_rows, rows_in_range
from stylesplat.progress import say
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import ORIGIN, announced, choose_offset, offset_text

Format = Literal[
    "PLY", "SPZ", "SOG", "a streamed SOG", "glTF", "USD", "a checkpoint", ".ksplat", ".splat"
]
CONTENT_FORMATS: dict[str, Format] = {  # by what a name ends in
    **{".ply": "PLY", ".spz": "SPZ", ".sog": "SOG", ".glb": "glTF", ".gltf": "glTF"},
    **{".ksplat": ".ksplat", ".splat": ".splat"},
    **{SOG_META: "SOG", SOG_LEVELS: "a streamed SOG"},
    **dict.fromkeys(USD, "USD"),
    **dict.fromkeys(CHECKPOINTS, "a checkpoint"),
}
JSONS = (".gltf", *SOG_JSONS)  # names of formats that are JSON
CONTENT_HEAD = 1 << 12  # bytes that are looked at
SPLAT_ROWS = 64  # of a .splat
CONTENT_ROUNDING = 0.1  # of the length of a quaternion whose components are bytes
MAX_CHARACTER = 4  # bytes of one in UTF-8, of which the last may be cut
CONTENT_SHOWN = 40  # characters of a text in a message
POINTER = b"version https://git-lfs.github.com/spec/"
PAGES = (b"<!doctype html", b"<html", b"<head", b"<?xml", b"<!--")
UNPACK = "Unpack it, and give the file of splats in it"
OTHER = f"Give a file of splats ({', '.join(SPLATS)})"
# What files begin with that are no splats: 3 bytes at least, as a .splat has any
CONTENT_OTHERS = {
    b"\x1f\x8b\x08": ("a gzip archive", UNPACK),
    b"7z\xbc\xaf": ("a 7z archive", UNPACK),
    b"Rar!": ("a RAR archive", UNPACK),
    b"\xfd7zXZ": ("an xz archive", UNPACK),
    b"BZh": ("a bzip2 archive", UNPACK),
    b"(\xb5/\xfd": ("a zstd archive", UNPACK),
    b"\x89PNG": ("a PNG picture", OTHER),
    b"\xff\xd8\xff": ("a JPEG picture", OTHER),
    b"RIFF": ("a WebP picture or other media", OTHER),
    b"%PDF": ("a PDF", OTHER),
    b"\x93NUMPY": ("an array of NumPy", OTHER),
    b"\x89HDF": ("an HDF5 file", OTHER),
    b"SQLite": ("an SQLite database", OTHER),
    b"\x80\x02\x8a": ("a checkpoint of PyTorch", OTHER),
    b"\x80\x04\x95": ("a pickle of Python", OTHER),
}


def named_format(path: Path) -> Format | None:
    """The format that a file's name stands for."""
    return CONTENT_FORMATS.get(path.name if path.name in SOG_JSONS else path.suffix.lower())


def format_of(path: Path) -> Format:
    """The format of splats that a file has, whatever its name; a StyleSplatError if it has none.

    A `.ksplat` or `.splat` has no sure mark: a file of that name is one unless it is known to be
    something else, and any file is a .splat whose rows can be one.
    """
    head, name = read_bytes(path, first=CONTENT_HEAD), path.suffix.lower()
    found = _marked(head, path)
    if found is not None:
        return found
    other = _something_else(head, path)
    if other is None and name in (".ksplat", ".splat"):
        return CONTENT_FORMATS[name]
    if other is None and _has_splat_rows(path):
        return ".splat"
    what, remedy = other or ("of no format of splats that is known here", OTHER)
    raise StyleSplatError(f"Cannot read {path} as splats: it is {what}. {remedy}.")


def _marked(head: bytes, path: Path) -> Format | None:
    """The format that the first bytes name; of JSON and ZIP, what is in them."""
    if PLY.match(head):
        return "PLY"
    if head.startswith(GLB):
        return "glTF"
    if head.startswith(SPZ) or _unpacked(head).startswith(SPZ):
        return "SPZ"
    if head.startswith(KSPLAT):
        return ".ksplat"
    if head.startswith((USD_BINARY, USD_TEXT)):
        return "USD"
    if head.startswith(ZIP):
        return _zipped(_members(path))
    if head.removeprefix(BOM).lstrip()[:1] in (b"{", b"["):
        content = read_bytes(path)
        if b'"means"' in content and b'"quats"' in content:
            return "SOG"
        if b'"lodLevels"' in content and b'"tree"' in content:
            return "a streamed SOG"
        is_json = path.name.lower().endswith(JSONS)
        return "glTF" if b'"asset"' in content else named_format(path) if is_json else None
    return None


def _zipped(members: Sequence[str]) -> Format | None:
    """The format that an archive of these files has."""
    if members and members[0].lower().endswith(USD_INSIDE):
        return "USD"
    if any(each.endswith(f"/{TORCH_LIST}") for each in members):
        return "a checkpoint"
    return "SOG" if any(each.endswith(SOG_META) for each in members) else None


def _something_else(head: bytes, path: Path) -> tuple[str, str] | None:
    """What a file is instead of splats, and what to do with it."""
    start = head.removeprefix(BOM).lstrip()[:CONTENT_SHOWN].lower()
    if not head:
        return "empty", "Copy or download it again"
    if not any(head) and not np.frombuffer(read_bytes(path), np.uint8).any():
        return "nothing but zeros", "Copy or download it again"
    if head.startswith(POINTER):
        return "a pointer of Git LFS in place of the file", "Fetch the file: `git lfs pull`"
    if start.startswith(PAGES):
        return "a page of HTML or XML, as failed downloads leave it", "Download the file itself"
    if head.startswith(ZIP):
        inner = join_names(_members(path)) or "nothing that can be read"
        return f"a ZIP archive of {inner}, and no SOG, which has a {SOG_META}", UNPACK
    for magic, what in CONTENT_OTHERS.items():
        if head.startswith(magic):
            return what
    with suppress(UnicodeDecodeError):
        text = (head[:-MAX_CHARACTER] if len(head) == CONTENT_HEAD else head).decode()
        if not re.search(r"[\x00-\x08\x0e-\x1f]", text):
            return f"text, which begins {shorten(text.strip()[:CONTENT_SHOWN])!r}", OTHER
    return None


def _unpacked(head: bytes) -> bytes:
    """The first bytes of what a gzip holds; nothing of anything else."""
    with suppress(zlib.error):
        return zlib.decompressobj(wbits=31).decompress(head, len(SPZ))
    return b""


def _members(path: Path) -> list[str]:
    try:
        with open_binary(path) as file, zipfile.ZipFile(file) as archive:
            return archive.namelist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, struct.error):
        return [SOG_META] if path.suffix.lower() == ".sog" else []  # its reader says what is wrong


def _has_splat_rows(path: Path) -> bool:
    """Whether a file can be a .splat: places, sizes and unit quaternions are where they should."""
    content = read_bytes(path, first=SPLAT_ROWS * DOT_SPLAT_ROW.itemsize)
    if path.stat().st_size % DOT_SPLAT_ROW.itemsize or not content:
        return False
    rows = np.frombuffer(content, DOT_SPLAT_ROW)
    with np.errstate(invalid="ignore"):
        places, sizes = np.abs(rows["mean"]), rows["scale"]
        lengths = np.linalg.norm(rows["quat"] / 128 - 1, axis=1)
        return bool(
            (np.abs(lengths - 1) < CONTENT_ROUNDING).all()
            and (places <= LARGEST_POSITION).all()
            and (sizes >= 0).all()
            and (sizes <= math.exp(LARGEST_LOG)).all()
            and sizes.any()
        )


DRAWABLE_LOGIT = 30.0  # a logit: float32 has no opacity between its own and 1
DRAWABLE_SCALE = torch.tensor(PACKED_SMALLEST).log().item()  # its square, which renders take, is 0


def drawable(splats: Splats, path: Path) -> tuple[Splats, Int[Tensor, " M"]]:
    """The Gaussians of a file that can be drawn, and their rows; a line says what is left out."""
    rows = torch.arange(len(splats))
    if not len(splats):
        raise StyleSplatError(f"There are no Gaussians in {path}. Choose another file.")
    if splat_fault(splats) is None:
        return splats, rows
    splats = _without_limits(splats)
    bad, reasons = torch.zeros(len(splats), dtype=torch.bool), list[str]()
    for mask, what in _faults(splats):
        count = int((mask & ~bad).sum())
        if count:
            reasons.append(f"{count:,} {what}")
        bad |= mask
    why = ", ".join(reasons)
    if bad.all():
        raise StyleSplatError(
            f"Cannot read {path} as splats: none of its {len(splats):,} Gaussians can be drawn "
            f"({why}). Export it again."
        )
    if not reasons:
        return splats, rows
    say(
        f"{path}: {int(bad.sum()):,} of {len(splats):,} Gaussians cannot be drawn and are left "
        f"out ({why})."
    )
    return splats[~bad], rows[~bad]


def _without_limits(splats: Splats) -> Splats:
    """The same with numbers for what has a limit as its logit or logarithm, and renders alike.

    An opacity of 1 or 0, a thickness of 0; and rotations whose quaternions are far from unit ones.
    """
    opacities, declared = splats.opacities, GAUSSIANS["opacities"]
    opacities = torch.where(opacities.isinf(), DRAWABLE_LOGIT * opacities.sign(), opacities)
    lengths = splats.quats.abs().amax(dim=1, keepdim=True)
    odd = (lengths > 0) & ~((SMALLEST_QUAT <= lengths) & (lengths <= GAUSSIANS["quats"].high))
    return replace(
        splats,
        opacities=opacities.clamp(declared.low, declared.high),
        scales=torch.where(splats.scales < GAUSSIANS["scales"].low, DRAWABLE_SCALE, splats.scales),
        quats=torch.where(odd & lengths.isfinite(), splats.quats / lengths, splats.quats),
    )


def _faults(splats: Splats) -> Iterator[tuple[Bool[Tensor, " N"], str]]:
    """Which Gaussians cannot be drawn, by the first reason that holds."""
    unturned = (splats.quats.abs() < SMALLEST_QUAT).all(dim=1)
    filled = torch.stack([as_rows(t).any(dim=1) for t in splats.tensors().values()]).any(dim=0)
    yield unturned & ~filled, "rows of zeros"
    names = {"means": "position", "scales": "size", "quats": "rotation", "opacities": "opacity"}
    for name, declared in GAUSSIANS.items():
        values, what = getattr(splats, name), names.get(name, "colour")
        yield ~as_rows(values).isfinite().all(dim=1), f"whose {what} is not finite"
        yield ~rows_in_range(values, declared), f"whose {what} is out of range"
    yield unturned, "whose rotation is 0"


COMPRESSED = ".compressed.ply"  # what SuperSplat calls its own
WRITERS: dict[str, Callable[[Splats, Path], None]] = {  # of all formats but plain PLY
    COMPRESSED: write_compressed_ply,
    ".spz": write_spz,
    ".splat": write_dot_splat,
    ".sog": write_sog,
    ".glb": write_glb,
    ".gltf": write_gltf,
    **dict.fromkeys(USD, write_usd),
}
SPZ_INSIDE = {".glb": write_glb, ".gltf": write_gltf}  # if a version of SPZ is asked for
UNMARKED = (".splat", ".glb", ".gltf", *USD)  # formats without a place for the anti-aliasing mark
WITH_OFFSET = (".ply", ".glb", ".gltf", *USD)  # formats that hold coordinates in 64 bits


def _read_ply(path: Path) -> Splats:
    compressed = is_compressed(read_header(path))
    return read_compressed_ply(path) if compressed else parse_splat_ply(path)


# They raise any error for damaged content, which `read_splats` names; numbers are as in the file.
# Positions are in the world, with 64 bits where the file may have more than 32.
READERS: dict[Format, Callable[[Path], Splats]] = {
    "PLY": _read_ply,
    "SPZ": read_spz,
    "SOG": read_sog,
    "a streamed SOG": read_streamed_sog,
    "glTF": read_gltf,
    "USD": read_usd,
    "a checkpoint": read_checkpoint,
    ".ksplat": read_ksplat,
    ".splat": read_dot_splat,
}


def read_splats(path: Path | str) -> Splats:
    """Read splats as other programs write them, in the world frame of their file.

    PLY as INRIA, gsplat, nerfstudio, Postshot and Brush write it, SuperSplat's compressed PLY, SPZ,
    .splat, .ksplat, glTF, USD, checkpoints of gsplat and splatfacto, and SOG, as a bundle, as the
    meta.json of a folder or, streamed, as a lod-meta.json; contents count, not names. No memory is
    allocated for a count that was not checked against the file. Gaussians that cannot be drawn are
    left out, with a line. Where coordinates are too large for float32 the splats get a
    `world_offset`, and a line says so.
    """
    return read_drawable(path)[0]


def read_drawable(path: Path | str) -> tuple[Splats, Int[Tensor, " N"], int]:
    """The splats of `read_splats`, their rows in the file, and how many rows that has."""
    path = Path(path)
    known = path.suffix.lower() in SPLATS or path.name in SOG_JSONS
    if path.is_dir() or not is_there(path):
        raise wrong_kind_error(path, "splat")
    with reading(path, "Export it again.", what=" as splats"):
        try:
            found = format_of(path)
        except StyleSplatError as error:
            raise (error if known else wrong_kind_error(path, "splat")) from error
        if named_format(path) != found:
            say(f"{path} holds {found}, whatever its name says: it is read as that.")
        splats = READERS[found](path)
        drawn, rows = drawable(splats, path)
        return _in_32_bits(drawn, path), rows, len(splats)


def declared_up(path: Path | str) -> str | None:
    """The direction that a file of splats calls up in a comment of its own, such as 'z'."""
    path = Path(path)
    return vertical_axis(read_header(path).comments) if format_of(path) == "PLY" else None


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
    if splats.antialiased and suffix in UNMARKED and spz_version is None:
        say(
            f"{path} has no place for a mark that its splats are anti-aliased: in its viewer, turn "
            "anti-aliasing on."
        )
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

"""What a file holds, told by its first bytes: a format of splats, or what else it is."""

import math
import re
import struct
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np

from stylesplat.errors import StyleSplatError, join_names, shorten
from stylesplat.io.files import open_binary, read_bytes
from stylesplat.io.kinds import SOG_META, SPLATS
from stylesplat.io.ply import BOM
from stylesplat.io.ply import PLY_MAGIC as PLY
from stylesplat.io.splats.dot_splat import DOT_SPLAT_MAGIC as KSPLAT
from stylesplat.io.splats.dot_splat import DOT_SPLAT_ROW
from stylesplat.io.splats.gltf_file import GLB_MAGIC as GLB
from stylesplat.io.splats.sog import ZIP
from stylesplat.io.splats.spz import MAGIC as SPZ
from stylesplat.io.tensors import LARGEST_LOG, LARGEST_POSITION

Format = Literal["PLY", "SPZ", "SOG", "glTF", ".ksplat", ".splat"]
CONTENT_FORMATS: dict[str, Format] = {  # by what a name ends in
    **{".ply": "PLY", ".spz": "SPZ", ".sog": "SOG", ".glb": "glTF", ".gltf": "glTF"},
    **{".ksplat": ".ksplat", ".splat": ".splat", SOG_META: "SOG"},
}
JSONS = (".gltf", SOG_META)  # names of formats that are JSON
CONTENT_HEAD = 1 << 12  # bytes that are looked at
ROWS = 64  # of a .splat
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
    return CONTENT_FORMATS.get(SOG_META if path.name == SOG_META else path.suffix.lower())


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
    if head.startswith(ZIP):
        return "SOG" if any(each.endswith(SOG_META) for each in _members(path)) else None
    if head.removeprefix(BOM).lstrip()[:1] in (b"{", b"["):
        content = read_bytes(path)
        if b'"means"' in content and b'"quats"' in content:
            return "SOG"
        is_json = path.name.lower().endswith(JSONS)
        return "glTF" if b'"asset"' in content else named_format(path) if is_json else None
    return None


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
    content = read_bytes(path, first=ROWS * DOT_SPLAT_ROW.itemsize)
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

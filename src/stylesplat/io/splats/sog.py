"""Splats as SOG, PlayCanvas's format: lossless WebP pictures that a meta.json describes.

The format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

import io
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import torch
from jaxtyping import Float, UInt8
from msgspec import Meta
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import inside, read_bytes, reason
from stylesplat.io.json_files import PhotoName, fitting, json_object, strict_json
from stylesplat.io.kinds import SOG_META
from stylesplat.io.splats.packing import (
    CODEBOOK_SIZE,
    LARGEST,
    encode,
    fit_codebook,
    from_smallest_three,
    morton_order,
    smallest_three,
    tree_kmeans,
)
from stylesplat.io.splats.splat_ply import check_splats, splat_fault
from stylesplat.scene.splats import Splats

VERSION = 2
PALETTE = 2**16  # entries: two bytes name one
PALETTE_COLUMNS = 64  # entries in a row of the palette's picture
MOST = 2**28  # Gaussians: WebP has sides of 14 bits
FARTHEST = 30.0  # logarithm of a position, which float32 holds
FIRST_TAG = 252  # alpha of a rotation whose first component is largest; 255 if it is the last
SURE = 1e-6  # from 0 and 1: opacities of 0 and 1 have no logit; splat-transform's bound
OPAQUE = 255  # alpha where it has no meaning
BLOCK = 4  # sides are multiples of it, as splat-transform's
MOST_PER_BYTE = 4  # Gaussians; real files need several bytes for one
SMALL = 2**16  # Gaussians that are allowed whatever the file's size
SPARE = 2  # pixels for a Gaussian; SMALL more are allowed
MAX_META = 2**20  # bytes; three codebooks have 20,000
ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others cannot be unpacked within bounds
MAX_GROWTH = 4  # of what is unpacked: pictures are compressed already
ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # of every entry, so that the same splats make the same file
WEBP_METHOD, WEBP_QUALITY = 1, 0  # of the search; more takes three times as long for 2% of the size
WEBP_HEADER = 30  # bytes that tell the size
WEBP_CHUNK = struct.Struct("<4sI")  # name and size of a part
SIDE_BITS = 14  # of a side of a simple WebP picture
MAX_SIDE = 2**SIDE_BITS - 1

Members = Callable[[str], bytes]
"""The content of a file of the SOG by its name."""
Texels = UInt8[np.ndarray, "M D"]
Logarithm = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]
Corner = tuple[Logarithm, Logarithm, Logarithm]
Number = Annotated[float, Meta(ge=-1e30, le=1e30)]  # float32 holds it; `check_splats` does the rest
Codebook = Annotated[tuple[Number, ...], Meta(min_length=1, max_length=CODEBOOK_SIZE)]


class _Quats(msgspec.Struct):
    files: tuple[PhotoName]


class _Means(msgspec.Struct):
    """Positions as sign(x) * log(1 + |x|), of 16 bits between `mins` and `maxs`."""

    mins: Corner
    maxs: Corner
    files: tuple[PhotoName, PhotoName]
    """The pictures of the lower bytes and of the upper ones."""


class _Coded(msgspec.Struct):
    """Bytes that are indices of a codebook."""

    codebook: Codebook
    files: tuple[PhotoName]


class _Palette(msgspec.Struct):
    """Higher bands of colour: entries of a palette."""

    count: Annotated[int, Meta(ge=1, le=PALETTE)]
    bands: Literal[1, 2, 3]
    """The degree."""
    codebook: Codebook
    files: tuple[PhotoName, PhotoName]
    """The picture of the entries, and that of each Gaussian's entry."""


class _Meta(msgspec.Struct):
    """The meta.json, as far as it is used."""

    version: Literal[2]
    count: Annotated[int, Meta(ge=0, le=MOST)]
    means: _Means
    scales: _Coded
    quats: _Quats
    sh0: _Coded
    """Colours, and opacities as alpha."""
    shN: _Palette | None = None


def read_sog(path: Path | str) -> Splats:
    """Read a bundle, or the folder of a meta.json, into PLY's conventions; rows keep their order.

    Counts are checked against the size of the files before memory is allocated for them.
    """
    path = Path(path)
    members = _folder_members(path) if path.name == SOG_META else _bundle_members(path)
    where = path if path.name == SOG_META else path / SOG_META
    content, what = json_object(members(SOG_META), where), f"Cannot read {path}"
    version = content.get("version", 1)
    if version != VERSION:
        what += f" as SOG of version {brief(str(version))}, only {VERSION} is read here"
        content["version"] = version if isinstance(version, int) else 0
    meta: _Meta = fitting(content, _Meta, what, "Export it again, as version 2.")
    pictures = _Pictures(path, meta, members)
    try:
        splats = _splats(meta, pictures)
    except ValueError as error:
        raise _cannot_read(path, str(error)) from error
    return check_splats(splats, path)


class _Pictures:
    """The pictures, loaded as files and decoded once their sizes are known to fit."""

    def __init__(self, path: Path, meta: _Meta, members: Members) -> None:
        parts = (meta.means, meta.quats, meta.scales, meta.sh0, meta.shN)
        names = {name for part in parts if part for name in part.files}
        self.path, self.count = path, meta.count
        self.files = {name: members(name) for name in names}
        size = sum(map(len, self.files.values()))
        if meta.count > max(MOST_PER_BYTE * size, SMALL):
            fault = f"it claims {meta.count} Gaussians, which {size} bytes of pictures cannot hold"
            raise _cannot_read(path, fault)
        self.size = self._size(meta.means.files[0])
        room = self.size[0] * self.size[1]
        if not meta.count <= room <= SPARE * meta.count + SMALL:
            raise _cannot_read(path, f"it has pictures of {room} pixels for {meta.count} Gaussians")

    def rows(self, name: str) -> Texels:
        """The pixel of each Gaussian."""
        return self._pixels(name, self.size)[: self.count]

    def palette(self, declared: _Palette) -> Texels:
        """The pixels of the palette, those of an entry after another."""
        bands = (declared.bands + 1) ** 2 - 1
        size = (PALETTE_COLUMNS * bands, -(-declared.count // PALETTE_COLUMNS))
        return self._pixels(declared.files[0], size)[: declared.count * bands]

    def _pixels(self, name: str, size: tuple[int, int]) -> Texels:
        found = self._size(name)
        if found != size:
            has, needed = (f"{width} x {height}" for width, height in (found, size))
            raise ValueError(f"{brief(name)!r} has {has} pixels, where {needed} are due")
        with self._naming(name):
            return _webp_pixels(self.files[name]).reshape(-1, 4)

    def _size(self, name: str) -> tuple[int, int]:
        with self._naming(name):
            return _webp_size(self.files[name])

    @contextmanager
    def _naming(self, name: str) -> Iterator[None]:
        try:
            yield
        except ValueError as error:
            raise _cannot_read(self.path, f"{brief(name)!r}: {error}") from error


def _splats(meta: _Meta, pictures: _Pictures) -> Splats:
    colors = pictures.rows(meta.sh0.files[0])
    alphas = torch.from_numpy(colors[:, 3] / np.float32(255))
    splats = Splats(
        means=_read_means(meta, pictures),
        quats=_read_quats(pictures.rows(meta.quats.files[0])),
        scales=_decode(pictures.rows(meta.scales.files[0])[:, :3], meta.scales.codebook),
        opacities=alphas.clamp(SURE, 1 - SURE).logit(),
        sh0=_decode(colors[:, None, :3], meta.sh0.codebook),
        shN=torch.zeros(meta.count, 0, 3),
    )
    return splats if meta.shN is None else replace(splats, shN=_read_bands(meta.shN, pictures))


def _read_means(meta: _Meta, pictures: _Pictures) -> Float[Tensor, "N 3"]:
    low, high = (pictures.rows(name)[:, :3].astype(np.float64) for name in meta.means.files)
    start, end = np.array(meta.means.mins), np.array(meta.means.maxs)
    logs = start + (end - start) * (low + 256 * high) / 65535
    return torch.from_numpy((np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32))


def _read_quats(texels: Texels) -> Float[Tensor, "N 4"]:
    bad = int((texels[:, 3] < FIRST_TAG).sum())
    if bad:
        raise ValueError(f"{bad} rotations do not tell their largest part")
    largest = torch.from_numpy(texels[:, 3].astype(np.int64) - FIRST_TAG)
    others = torch.from_numpy(texels[:, :3] / np.float32(255)) * 2 - 1
    return from_smallest_three(largest, others * LARGEST)


def _read_bands(declared: _Palette, pictures: _Pictures) -> Float[Tensor, "N _ 3"]:
    choices = pictures.rows(declared.files[1]).astype(np.int64)
    labels = torch.from_numpy(choices[:, 0] + 256 * choices[:, 1])
    bad = int((labels >= declared.count).sum())
    if bad:
        raise ValueError(f"{bad} Gaussians have colours beyond the palette's {declared.count}")
    entries = _decode(pictures.palette(declared)[:, :3], declared.codebook)
    return entries.unflatten(0, (declared.count, -1))[labels]


def _decode(texels: UInt8[np.ndarray, "*B"], codebook: Codebook) -> Float[Tensor, "*B"]:
    bad = int((texels >= len(codebook)).sum())
    if bad:
        raise ValueError(f"{bad} bytes are beyond a codebook of {len(codebook)}")
    return torch.from_numpy(np.array(codebook, np.float32)[texels])


def write_sog(splats: Splats, path: Path | str) -> None:
    """Write a bundle, in Morton order, its numbers rounded.

    Positions have 16 bits along each axis, finest near the origin; rotations and opacities 8;
    scales and colours are one of 256 values that fit these splats best; higher bands of colour are
    one of a palette of 65536 entries or, for fewer Gaussians, the next lower power of two.
    """
    path = Path(path)
    fault = splat_fault(splats) if len(splats) else None
    if fault:
        raise StyleSplatError(f"Cannot export to {path}: {fault}. Export a .ply.")
    count = len(splats)
    width = max(1, math.ceil(math.sqrt(count) / BLOCK)) * BLOCK
    height = max(1, math.ceil(count / width / BLOCK)) * BLOCK
    if width > MAX_SIDE:
        raise StyleSplatError(
            f"Cannot export to {path}: {count} Gaussians are more than its pictures can hold. "
            "Export a .ply."
        )
    splats = splats[morton_order(splats.means)]
    files = dict[str, bytes]()

    def add(name: str, texels: Texels, width: int = width, height: int = height) -> str:
        """Make a picture; missing pixels and channels are 0, alpha is opaque."""
        pixels = np.zeros((height * width, 4), np.uint8)
        pixels[:, 3] = OPAQUE
        pixels[: len(texels), : texels.shape[1]] = texels
        files[name] = _webp_of(pixels.reshape(height, width, 4))
        return name

    scale_codes, color_codes = (
        fit_codebook(numbers.numpy()) for numbers in (splats.scales, splats.sh0)
    )
    alphas = _to_bytes(torch.sigmoid(splats.opacities))
    color_texels = np.column_stack([encode(splats.sh0[:, 0].numpy(), color_codes), alphas])
    scale_texels = encode(splats.scales.numpy(), scale_codes)
    about = {
        "version": VERSION,
        "asset": {"generator": "StyleSplat"},
        "count": count,
        "means": _write_means(splats, add),
        "scales": {"codebook": scale_codes, "files": [add("scales.webp", scale_texels)]},
        "quats": {"files": [add("quats.webp", _quat_texels(splats))]},
        "sh0": {"codebook": color_codes, "files": [add("sh0.webp", color_texels)]},
    }
    if count and splats.shN.shape[1]:
        about["shN"] = _write_bands(splats, add)
    files[SOG_META] = strict_json(about).encode()
    with atomic_path(path) as draft, zipfile.ZipFile(draft, "w") as bundle:
        for name, content in files.items():
            bundle.writestr(zipfile.ZipInfo(name, ZIP_DATE), content)


def _write_means(splats: Splats, add: Callable[[str, Texels], str]) -> dict[str, Any]:
    logs = splats.means.double().numpy()
    logs = np.sign(logs) * np.log1p(np.abs(logs))
    low = logs.min(axis=0) if len(logs) else np.zeros(3)
    high = logs.max(axis=0) if len(logs) else np.zeros(3)
    steps = np.divide(logs - low, high - low, where=high > low, out=np.zeros_like(logs))
    steps = (steps * 65535).round().astype(np.uint16)
    files = [
        add("means_l.webp", (steps & 255).astype(np.uint8)),
        add("means_u.webp", (steps >> 8).astype(np.uint8)),
    ]
    return {"mins": low, "maxs": high, "files": files}


def _quat_texels(splats: Splats) -> Texels:
    largest, others = smallest_three(splats.quats)
    tags = (largest + FIRST_TAG).byte().numpy()
    return np.column_stack([_to_bytes((others / LARGEST + 1) / 2), tags])


def _write_bands(splats: Splats, add: Callable[..., str]) -> dict[str, Any]:
    most = min(PALETTE, 2 ** int(math.log2(len(splats))))
    entries, labels = tree_kmeans(splats.shN.flatten(1).numpy(), most)
    codebook = fit_codebook(entries)
    count, bands = len(entries), splats.shN.shape[1]
    texels = encode(entries, codebook).reshape(count * bands, 3)
    width, height = PALETTE_COLUMNS * bands, math.ceil(count / PALETTE_COLUMNS)
    choices = np.column_stack([labels & 255, labels >> 8]).astype(np.uint8)
    files = [
        add("shN_centroids.webp", texels, width, height),
        add("shN_labels.webp", np.pad(choices, ((0, 0), (0, 1)))),
    ]
    return {"count": count, "bands": splats.sh_degree, "codebook": codebook, "files": files}


def _to_bytes(shares: torch.Tensor) -> UInt8[np.ndarray, "..."]:
    return (shares * 255).round().clamp(0, 255).byte().numpy()


def _folder_members(path: Path) -> Members:
    def member(name: str) -> bytes:
        file = inside(path.parent, name)
        return read_bytes(file, most=MAX_META if name == SOG_META else None)

    return member


def _bundle_members(path: Path) -> Members:
    content = read_bytes(path)
    try:
        bundle = zipfile.ZipFile(io.BytesIO(content))
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
        raise _cannot_read(path, f"it is no zip file ({reason(error)})") from error

    def member(name: str) -> bytes:
        most = MAX_META if name == SOG_META else MAX_GROWTH * len(content)
        try:
            return _unpack(bundle, name, most)
        except KeyError as error:
            raise _cannot_read(path, f"there is no {brief(name)!r} in it") from error
        # zipfile raises a RuntimeError for encrypted entries
        except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError) as error:
            raise _cannot_read(path, f"{brief(name)!r}: {reason(error)}") from error

    return member


def _unpack(bundle: zipfile.ZipFile, name: str, most: int) -> bytes:
    entry = bundle.getinfo(name)
    if entry.compress_type not in ZIP_METHODS:
        raise ValueError("it is packed in a way that the format has not")
    if entry.file_size > most:
        raise ValueError(f"it would unpack to {entry.file_size} bytes")
    with bundle.open(entry) as file:
        content = file.read(entry.file_size)  # and no more, whatever follows
        if len(content) != entry.file_size or file.read(1):
            raise ValueError("it is cut off")
    return content


def _webp_of(pixels: UInt8[np.ndarray, "H W 4"]) -> bytes:
    """A lossless picture, exact where it is transparent too."""
    file = io.BytesIO()
    options = {"lossless": True, "exact": True, "method": WEBP_METHOD, "quality": WEBP_QUALITY}
    Image.fromarray(pixels).save(file, "WEBP", **options)
    return file.getvalue()


def _webp_size(content: bytes) -> tuple[int, int]:
    """Width and height from the header (https://developers.google.com/speed/webp/docs)."""
    head = content[:WEBP_HEADER]
    if len(head) < WEBP_HEADER or head[:4] != b"RIFF" or head[8:12] != b"WEBP":
        raise ValueError("it is no WebP picture")
    if head[12:16] == b"VP8L":
        sides = int.from_bytes(head[21:25], "little")
        return 1 + (sides & MAX_SIDE), 1 + (sides >> SIDE_BITS & MAX_SIDE)
    if head[12:16] == b"VP8X" and _is_lossless(content):
        return 1 + int.from_bytes(head[24:27], "little"), 1 + int.from_bytes(head[27:30], "little")
    raise ValueError("it is a lossy or moving picture, whose pixels are no numbers")


def _is_lossless(content: bytes) -> bool:
    """Whether the first part of an extended WebP file that holds pixels is one lossless picture."""
    offset = WEBP_HEADER
    while offset + WEBP_CHUNK.size <= len(content):
        name, size = WEBP_CHUNK.unpack_from(content, offset)
        if name in (b"VP8L", b"VP8 ", b"ALPH", b"ANIM", b"ANMF"):
            return name == b"VP8L"
        offset += WEBP_CHUNK.size + size + size % 2
    return False


def _webp_pixels(content: bytes) -> UInt8[np.ndarray, "H W 4"]:
    try:
        with warnings.catch_warnings(action="ignore"):
            image = Image.open(io.BytesIO(content), formats=("WEBP",))
            return np.asarray(image.convert("RGBA"))
    except MemoryError:
        raise
    except Exception as error:  # Pillow raises all kinds
        raise ValueError(f"it is damaged ({error})") from error


def _cannot_read(path: Path, fault: str) -> StyleSplatError:
    return StyleSplatError(f"Cannot read {path}: {fault}. Export it again.")

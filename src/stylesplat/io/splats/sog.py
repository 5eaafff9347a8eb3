"""Splats as SOG, PlayCanvas's format: lossless WebP pictures that a meta.json describes.

A streamed SOG is several of them, of parts and levels of detail, which a lod-meta.json lists.
The format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

import io
import math
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from msgspec import Meta
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes, reading, reason, resolve_within
from stylesplat.io.json_yaml import PhotoName, json_object, read_json, strict_json
from stylesplat.io.kinds import SOG_META
from stylesplat.io.splats.packing import (
    CODEBOOK_SIZE,
    PACKED_LARGEST,
    PACKED_NEAR,
    encode,
    fit_codebook,
    from_smallest_three,
    morton_order,
    smallest_three,
    to_bytes,
    tree_kmeans,
)
from stylesplat.io.splats.splat_ply import BANDS, MAX_DEGREE, joined, refuse_faulty
from stylesplat.progress import say
from stylesplat.scene.splats import Splats

SOG_VERSION = 2  # that is written; version 1 has ranges in place of codebooks, and no number
PALETTE = 2**16  # entries: two bytes name one
PALETTE_COLUMNS = 64  # entries in a row of the palette's picture
SOG_MOST = 2**28  # Gaussians: WebP has sides of 14 bits
SOG_FARTHEST = 30.0  # logarithm of a position, which float32 holds
FIRST_TAG = 252  # alpha of a rotation whose first component is largest; 255 if it is the last
SOG_OPAQUE = 255  # alpha where it has no meaning
SOG_BLOCK = 4  # sides are multiples of it, as splat-transform's
MOST_PER_BYTE = 4  # Gaussians; real files need several bytes for one
SOG_SMALL = 2**16  # Gaussians that are allowed whatever the file's size
SOG_SPARE = 2  # pixels for a Gaussian; SMALL more are allowed
MAX_META = 2**20  # bytes; three codebooks have 20,000
MAX_LEVELS = 2**26  # bytes of a lod-meta.json: some 100 for a part of thousands of Gaussians
ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others cannot be unpacked within bounds
MAX_GROWTH = 4  # of what is unpacked: pictures are compressed already
ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # of every entry, so that the same splats make the same file
WEBP_HEADER = 2**12  # bytes at the start of a WebP picture, which name the kind of its pixels
SOG_MAX_SIDE = 2**14 - 1  # of a WebP picture
ZIP = (b"PK\3\4", b"PK\5\6")  # the second of an empty one
SOG_ANTIALIASED = "antialiased"
# Of splat-transform; flat scales are what makes the last
MODELS = ("default", SOG_ANTIALIASED, "2dgs")
Reader = Callable[[str], bytes]
"""Reads a file of the SOG by its name."""
SogTexels = UInt8[np.ndarray, "M D"]
Logarithm = Annotated[float, Meta(ge=-SOG_FARTHEST, le=SOG_FARTHEST)]
Corner = tuple[Logarithm, Logarithm, Logarithm]
# float32 holds it; `drawable` does the rest
SogNumber = Annotated[float, Meta(ge=-1e30, le=1e30)]
SogCount = Annotated[int, Meta(ge=0, le=SOG_MOST)]
SogChannels = Annotated[tuple[SogNumber, ...], Meta(max_length=4)]
Codebook = Annotated[tuple[SogNumber | None, ...], Meta(min_length=1, max_length=CODEBOOK_SIZE)]
"""Values of bytes; the first may be null, where splat-transform had no number for it."""


class _Quats(msgspec.Struct):
    files: tuple[PhotoName]


class _Means(msgspec.Struct):
    """Positions as sign(x) * log(1 + |x|), of 16 bits between `mins` and `maxs`."""

    mins: Corner
    maxs: Corner
    files: tuple[PhotoName, PhotoName]
    """The pictures of the lower bytes and of the upper ones."""
    shape: tuple[SogCount, ...] = ()
    """In version 1, how many they are, and 3."""


class _Coded(msgspec.Struct):
    """Bytes that are indices of a codebook or, in version 1, from each channel's range."""

    files: tuple[PhotoName]
    codebook: Codebook | None = None
    mins: SogChannels = ()
    maxs: SogChannels = ()


class _Palette(msgspec.Struct):
    """Higher bands of colour: entries of a palette.

    Their picture tells how many there are, and of how many bands; some programs write neither
    number, or another.
    """

    count: Annotated[int, Meta(ge=1, le=PALETTE)] | None = None
    bands: int | None = None
    codebook: Codebook | None = None
    mins: SogNumber | None = None
    maxs: SogNumber | None = None
    files: Annotated[tuple[PhotoName, ...], Meta(max_length=2)] = ()
    """The picture of the entries, and that of each Gaussian's entry."""


class _Meta(msgspec.Struct):
    """The meta.json, as far as it is used."""

    means: _Means
    scales: _Coded
    quats: _Quats
    sh0: _Coded
    """Colours, and opacities as alpha; in version 1 as logits in a fourth range."""
    count: SogCount | None = None
    shN: _Palette | None = None
    antialias: bool | None = None
    """Whether the splats were trained for an anti-aliased rendering: the specification's mark."""
    model: str | None = None
    """The same as splat-transform writes it."""


class _Run(msgspec.Struct):
    """Rows of one of the files."""

    file: Annotated[int, Meta(ge=0)]
    offset: Annotated[int, Meta(ge=0)]
    count: Annotated[int, Meta(ge=0)]


class _Node(msgspec.Struct):
    """A part of a streamed SOG: parts of its own, or its Gaussians by level, the finest first."""

    children: tuple["_Node", ...] = ()
    lods: dict[str, _Run] = {}


class _Levels(msgspec.Struct):
    """The lod-meta.json of a streamed SOG, as far as it is used."""

    filenames: tuple[PhotoName, ...]
    tree: _Node
    environment: PhotoName | None = None
    """What is far around, without levels."""


def read_streamed_sog(path: Path | str) -> Splats:
    """Read the finest level of each part of a streamed SOG, and what is around it.

    A line says how many levels there are, if there are several.
    """
    path = Path(path)
    about = msgspec.convert(read_json(path, most=MAX_LEVELS), _Levels)
    runs, levels, nodes = dict[int, list[_Run]](), set[str](), [about.tree]
    while nodes:
        node = nodes.pop()
        nodes += node.children
        levels |= node.lods.keys()
        if node.lods:
            run = node.lods[min(node.lods, key=_level)]
            runs.setdefault(run.file, []).append(run)
    if any(file >= len(about.filenames) for file in runs):
        raise ValueError(f"it has rows of a file beyond its {len(about.filenames)}")
    names = {file: about.filenames[file] for file in sorted(runs)}
    every = [*names.values(), *([about.environment] if about.environment else [])]
    if len({*every}) < len(every):
        raise ValueError("it names a file twice")
    parts = list[Splats]()
    for file, name in names.items():
        part = _part_of(path, name)
        end = 0
        for run in sorted(runs[file], key=lambda run: run.offset):
            if run.offset < end:
                raise ValueError(f"it has rows of {shorten(name)!r} twice")
            end = run.offset + run.count
            parts.append(part[run.offset : end])
        if end > len(part):
            raise ValueError(f"it has rows beyond the {len(part)} of {shorten(name)!r}")
    if about.environment is not None:
        parts.append(_part_of(path, about.environment))
    splats = joined(parts)
    if len(levels) > 1:
        say(f"{path} has {len(levels)} levels of detail: the finest is read, the others are not.")
    return splats


def _level(name: str) -> int:
    if not name.isdecimal():
        raise ValueError(f"it has a level {shorten(name)!r}, which is no number")
    return int(name)


def _part_of(path: Path, name: str) -> Splats:
    """One of the files of a streamed SOG, which an error names."""
    part = resolve_within(path.parent, name)
    with reading(part, "Export it again.", what=" as splats"):
        return read_sog(part)


def read_sog(path: Path | str) -> Splats:
    """Read a bundle, or the folder of a meta.json, into PLY's conventions, row by row."""
    path = Path(path)
    bundled = read_bytes(path, first=4).startswith(ZIP)
    member = _bundle_reader(path) if bundled else _folder_reader(path)
    content = json_object(member(SOG_META), path)
    version = content.get("version", 1)
    if version not in (1, SOG_VERSION):
        raise ValueError(f"it is SOG of version {version!s:.20}, only 1 and 2 are read here")
    meta = msgspec.convert(content, _Meta)
    parts = (meta.means, meta.quats, meta.scales, meta.sh0, meta.shN)
    files = {name: member(name) for part in parts if part for name in part.files}
    if meta.model not in (None, *MODELS):
        say(f"{path} is of the model {shorten(str(meta.model))!r}, which is unknown: left out.")
    marked = meta.antialias is True or meta.model == SOG_ANTIALIASED
    return replace(_decode(meta, files, path), antialiased=marked)


def _decode(meta: _Meta, files: Mapping[str, bytes], path: Path) -> Splats:
    """Splats from the pictures, which are decoded once their sizes are known to fit."""
    count, stored = meta.count, sum(map(len, files.values()))
    if count is None:
        if not meta.means.shape:
            raise ValueError("it does not say how many Gaussians it has")
        count = meta.means.shape[0]
    if count > max(MOST_PER_BYTE * stored, SOG_SMALL):
        raise ValueError(
            f"it claims {count} Gaussians, more than {stored} bytes of pictures can hold"
        )
    size = _open_webp(files, meta.means.files[0]).size
    if not count <= size[0] * size[1] <= SOG_SPARE * count + SOG_SMALL:
        raise ValueError(f"it has pictures of {size[0] * size[1]} pixels for {count} Gaussians")

    def rows(name: str) -> SogTexels:
        return _webp_pixels(files, name, size)[:count]

    low, high = (rows(name)[:, :3].astype(np.float64) for name in meta.means.files)
    start, end = np.array(meta.means.mins), np.array(meta.means.maxs)
    logs = start + (end - start) * (low + 256 * high) / 65535
    quats = rows(meta.quats.files[0])
    bad = int((quats[:, 3] < FIRST_TAG).sum())
    if bad:
        raise ValueError(f"{bad} rotations do not name their largest component")
    largest = torch.from_numpy(quats[:, 3].astype(np.int64) - FIRST_TAG)
    others = torch.from_numpy(quats[:, :3] / np.float32(255)) * 2 - 1
    colors = rows(meta.sh0.files[0])
    if meta.sh0.codebook is None:
        sh0, opacities = _look_up(colors, meta.sh0).split([3, 1], dim=1)
    else:
        alphas = torch.from_numpy(colors[:, 3] / np.float32(255))
        opacities = alphas.clamp(PACKED_NEAR, 1 - PACKED_NEAR).logit()
        sh0 = _look_up(colors[:, :3], meta.sh0)
    shN = torch.zeros(count, 0, 3)
    if meta.shN is not None and len(meta.shN.files) == 2:
        choices = rows(meta.shN.files[1]).astype(np.int64)
        labels = torch.from_numpy(choices[:, 0] + 256 * choices[:, 1])
        shN = _palette(meta.shN, files, path, labels)
    return Splats(
        means=torch.from_numpy(np.sign(logs) * np.expm1(np.abs(logs))),
        quats=from_smallest_three(largest, others * PACKED_LARGEST),
        scales=_look_up(rows(meta.scales.files[0])[:, :3], meta.scales),
        opacities=opacities.flatten().contiguous(),
        sh0=sh0[:, None],
        shN=shN,
    )


def _palette(
    palette: _Palette, files: Mapping[str, bytes], path: Path, labels: Int[Tensor, " N"]
) -> Float[Tensor, "N _ 3"]:
    """The higher bands of each Gaussian, of degrees up to 3."""
    width, height = _open_webp(files, palette.files[0]).size
    bands, rest = divmod(width, PALETTE_COLUMNS)
    degree = math.isqrt(bands + 1) - 1
    if rest or (degree + 1) ** 2 != bands + 1 or not bands:
        raise ValueError(f"its palette's picture is {width} pixels wide, which fits no degree")
    count = palette.count or PALETTE_COLUMNS * height
    if count > PALETTE:
        raise ValueError(f"its palette's picture is {height} pixels high, more than a palette has")
    if palette.bands != degree and palette.codebook is not None:
        told = "names no bands" if palette.bands is None else f"names {palette.bands} bands"
        say(f"{path} {told} of colour, but its palette has {degree}: these are read.")
    if degree > MAX_DEGREE:
        say(f"{path} has colours of degree {degree}: the bands above 3 are left out.")
    bad = int((labels >= count).sum())
    if bad:
        raise ValueError(f"{bad} Gaussians have colours beyond the palette's {count}")
    whole = (PALETTE_COLUMNS * bands, -(-count // PALETTE_COLUMNS))
    texels = _webp_pixels(files, palette.files[0], whole)[: count * bands, :3]
    used = texels.reshape(count, bands, 3)[:, : BANDS[-1]]
    return _look_up(np.ascontiguousarray(used), palette)[labels]


def _look_up(texels: UInt8[np.ndarray, "*B"], part: _Coded | _Palette) -> Float[Tensor, "*B"]:
    codebook = part.codebook
    if codebook is None:
        low, high = (np.array(each, np.float32) for each in (part.mins, part.maxs))
        size = texels.shape[-1:] if isinstance(part, _Coded) else ()
        if low.shape != size or high.shape != size or np.isnan([low, high]).any():
            raise ValueError("it has neither a codebook nor a range of its numbers")
        return torch.from_numpy(low + (high - low) * (texels / np.float32(255)))
    bad = int((texels >= len(codebook)).sum())
    if bad:
        raise ValueError(f"{bad} bytes are beyond a codebook of {len(codebook)}")
    values = np.array(codebook, np.float32)  # None becomes NaN
    if len(values) > 1 and np.isnan(values[0]):  # as PlayCanvas's engine extends the others
        values[0] = values[1] + (values[1] - values[-1]) / (CODEBOOK_SIZE - 1)
    return torch.from_numpy(values[texels])


def write_sog(splats: Splats, path: Path | str) -> None:
    """Write a bundle, in Morton order, its numbers rounded.

    Positions have 16 bits along each axis, finest near the origin; rotations and opacities 8;
    scales and colours are one of 256 values that fit these splats best; higher bands of colour are
    one of a palette of 65536 entries or, for fewer Gaussians, the next lower power of two.
    """
    path, count = Path(path), len(splats)
    refuse_faulty(splats, path)
    width = max(1, math.ceil(math.sqrt(count) / SOG_BLOCK)) * SOG_BLOCK
    height = max(1, math.ceil(count / width / SOG_BLOCK)) * SOG_BLOCK
    if width > SOG_MAX_SIDE:
        raise StyleSplatError(
            f"Cannot export to {path}: {count} Gaussians are more than its pictures can hold. "
            "Export a .ply."
        )
    splats = splats[morton_order(splats.means)]
    files = dict[str, bytes]()

    def add(name: str, texels: SogTexels, width: int = width, height: int = height) -> str:
        """Make a picture; missing pixels and channels are 0, alpha is opaque.

        `exact` keeps colours where alpha is 0. More than the least search for a small file takes
        three times as long for 2 % of the size.
        """
        pixels = np.zeros((height * width, 4), np.uint8)
        pixels[:, 3] = SOG_OPAQUE
        pixels[: len(texels), : texels.shape[1]] = texels
        file = io.BytesIO()
        picture = Image.fromarray(pixels.reshape(height, width, 4))
        picture.save(file, "WEBP", lossless=True, exact=True, method=1, quality=0)
        files[name] = file.getvalue()
        return name

    logs = splats.means.double().numpy()
    logs = np.sign(logs) * np.log1p(np.abs(logs))
    low = logs.min(axis=0) if count else np.zeros(3)
    high = logs.max(axis=0) if count else np.zeros(3)
    steps = np.divide(logs - low, high - low, where=high > low, out=np.zeros_like(logs))
    steps = (steps * 65535).round().astype(np.uint16)
    largest, others = smallest_three(splats.quats)
    tags = (largest + FIRST_TAG).byte().numpy()
    scale_codes = fit_codebook(splats.scales.numpy())
    color_codes = fit_codebook(splats.sh0.numpy())
    alphas = to_bytes(255 * torch.sigmoid(splats.opacities))
    colors = np.column_stack([encode(splats.sh0[:, 0].numpy(), color_codes), alphas])
    quats = np.column_stack([to_bytes(255 * ((others / PACKED_LARGEST + 1) / 2)), tags])
    scales = encode(splats.scales.numpy(), scale_codes)
    halves = {"means_l.webp": steps & 255, "means_u.webp": steps >> 8}
    means_files = [add(name, half.astype(np.uint8)) for name, half in halves.items()]
    about: dict[str, Any] = {
        "version": SOG_VERSION,
        "asset": {"generator": "StyleSplat"},
        "count": count,
        **({"antialias": True, "model": SOG_ANTIALIASED} if splats.antialiased else {}),
        "means": {"mins": low, "maxs": high, "files": means_files},
        "scales": {"codebook": scale_codes, "files": [add("scales.webp", scales)]},
        "quats": {"files": [add("quats.webp", quats)]},
        "sh0": {"codebook": color_codes, "files": [add("sh0.webp", colors)]},
    }
    if count and splats.shN.shape[1]:
        about["shN"] = _add_palette(splats, add)
    files[SOG_META] = strict_json(about).encode()
    with atomic_path(path) as draft, zipfile.ZipFile(draft, "w") as bundle:
        for name, content in files.items():
            bundle.writestr(zipfile.ZipInfo(name, ZIP_DATE), content)


def _add_palette(splats: Splats, add: Callable[..., str]) -> dict[str, Any]:
    """Make the pictures of the higher bands; what `meta.json` says of them."""
    bands, most = splats.shN.shape[1], min(PALETTE, 2 ** int(math.log2(len(splats))))
    entries, labels = tree_kmeans(splats.shN.flatten(1).numpy(), most)
    codebook = fit_codebook(entries)
    texels = encode(entries, codebook).reshape(len(entries) * bands, 3)
    width, height = PALETTE_COLUMNS * bands, math.ceil(len(entries) / PALETTE_COLUMNS)
    choices = np.column_stack([labels & 255, labels >> 8]).astype(np.uint8)
    files = [
        add("shN_centroids.webp", texels, width, height),
        add("shN_labels.webp", choices),
    ]
    return {
        "count": len(entries),
        "bands": splats.sh_degree,
        "codebook": codebook,
        "files": files,
    }


def _folder_reader(path: Path) -> Reader:
    def member(name: str) -> bytes:
        file = path if name == SOG_META else resolve_within(path.parent, name)
        return read_bytes(file, most=MAX_META if name == SOG_META else None)

    return member


def _bundle_reader(path: Path) -> Reader:
    content = read_bytes(path)
    bundle = zipfile.ZipFile(io.BytesIO(content))
    above = [each[: -len(SOG_META)] for each in bundle.namelist() if each.endswith(f"/{SOG_META}")]
    folder = above[0] if len(above) == 1 and SOG_META not in bundle.namelist() else ""

    def member(name: str) -> bytes:
        try:
            entry = bundle.getinfo(folder + name)
        except KeyError as error:
            raise ValueError(f"{shorten(name)!r} is not in the bundle") from error
        if entry.compress_type not in ZIP_METHODS:
            raise ValueError(f"{shorten(name)!r} has a compression that SOG does not use")
        if entry.file_size > (MAX_META if name == SOG_META else MAX_GROWTH * len(content)):
            raise ValueError(f"{shorten(name)!r} would unpack to {entry.file_size} bytes")
        with bundle.open(entry) as file:
            return file.read(entry.file_size)  # and no more, whatever follows

    return member


def _webp_pixels(files: Mapping[str, bytes], name: str, size: tuple[int, int]) -> SogTexels:
    image = _open_webp(files, name)
    if image.size != size:
        has, due = (f"{width} x {height}" for width, height in (image.size, size))
        raise ValueError(f"{shorten(name)!r} has {has} pixels instead of {due}")
    try:
        return np.asarray(image.convert("RGBA")).reshape(-1, 4)
    except OSError as error:
        raise ValueError(f"{shorten(name)!r}: {reason(error)}") from error


def _open_webp(files: Mapping[str, bytes], name: str) -> Image.Image:
    """Open a lossless picture, whose pixels are not decoded yet."""
    content = files[name]
    if b"VP8L" not in content[:WEBP_HEADER]:
        raise ValueError(
            f"{shorten(name)!r} is no lossless WebP picture, so its pixels are no numbers"
        )
    with warnings.catch_warnings(action="ignore"):
        return Image.open(io.BytesIO(content), formats=("WEBP",))

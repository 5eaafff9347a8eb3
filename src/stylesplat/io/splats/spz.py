"""Splats as SPZ, Niantic's compressed format: gzip (versions 1 to 3) or zstd (version 4)."""

import gzip
import struct
import zlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import gsply
import numpy as np
import torch
import zstandard
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError, check_choice, join_names
from stylesplat.io.atomic import write_file
from stylesplat.io.files import read_bytes
from stylesplat.io.splats.compressed_ply import to_gsply
from stylesplat.io.splats.packing import PACKED_LARGEST, PACKED_NEAR, from_smallest_three, to_floats
from stylesplat.io.splats.splat_ply import BANDS, MAX_DEGREE
from stylesplat.progress import say
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.splats import Splats

SPZ_VERSIONS = (4, 3, 2)  # that are written; 3 is larger by a twelfth, 2 has coarser rotations
SPZ_LARGEST_PLACE = 2**23 - 1  # largest fixed-point coordinate
FRACTION = range(1, 21)  # bits behind the point; 20 resolve a millionth
SPZ_SURE = 30.0  # a logit beyond which the byte of an opacity is 0 or 255; exp(88) overflows
COLOR_SCALE = 0.15  # of the constant band in a byte
GZIP, MAGIC = b"\x1f\x8b", b"NGSP"
SPZ_HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, degree, fraction, flags, 0
TABLE = struct.Struct("<4sIIBBBBI")  # version 4: the same, but number of streams, their table
TABLE_HEADER = 32  # bytes of version 4's, before its records
STREAM = struct.Struct("<QQ")  # bytes before and after compression
SPZ_RECORD = struct.Struct("<II")  # kind, bytes that follow
ROTATIONS = 16  # bytes of a Gaussian before its rotation: place, opacity, colour, size
SPZ_SMALLEST_ROW = 16  # bytes of a Gaussian without higher bands, before compression
SPZ_EXTENSIONS = 2**20  # bytes that may follow the Gaussians
SPZ_LARGEST_RATIO = 200  # of compression: real files reach 20, zeros 1000
HALF_FLOATS, SMALLEST_THREE, TABLES = 1, 3, 4  # versions of half floats, good rotations, tables
DEGREES = range(5)  # of colour that a file may have
FLAG_ANTIALIASED, FLAG_EXTENDED = 1, 2
FLAGS = 14  # their byte
# The record of SPZ_ADOBE_coordinate_system, and the axes of its numbers from 1 on. Letters count:
# Niantic's library of July 2026 turns LFD, RFD, LBU and RBU by half about x from what theirs say
AXES = 0xADBE0003
SPZ_NAMES = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
OWN_AXES, PLY_AXES = "RUB", "RDF"  # right, up, back without that record; right, down, forward
OPPOSITE = {"F": "B", "B": "F"}
QUARTER_TURN = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # x, z, -y


class _Header(NamedTuple):
    version: int
    rows: int
    degree: int
    fraction: int
    flags: int
    streams: int

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes of a Gaussian: place, opacity, colour, size, rotation, higher bands."""
        place, turn = 6 if self.version == HALF_FLOATS else 9, 3 + (self.version >= SMALLEST_THREE)
        return place, 1, 3, 3, turn, 3 * ((self.degree + 1) ** 2 - 1)


def read_spz(path: Path | str) -> Splats:
    """Read an SPZ file into PLY's axes, from those that it declares or from SPZ's own."""
    splats, axes = unpack_spz(read_bytes(path), path)
    if axes != OWN_AXES:
        say(f"{path} declares the axes {axes}: it is read from these.")
    return _in_ply_axes(splats, axes)


def unpack_spz(content: bytes, path: Path | str) -> tuple[Splats, str]:
    """The splats of an SPZ file's content, and their axes; `path` is for messages."""
    header, streams, records = _sections(content)
    count, degree = header.rows, min(header.degree, MAX_DEGREE)
    places, alphas, colors, sizes, turns, bands = (
        np.frombuffer(stream, np.uint8).reshape(count, width)
        for stream, width in zip(streams, header.widths, strict=True)
    )
    if degree < header.degree:
        say(f"{path} has colours of degree {header.degree}: the bands above 3 are left out.")
    splats = Splats(
        means=torch.from_numpy(_positions(places, header)),
        quats=_rotations(turns) if header.version >= SMALLEST_THREE else _coarse_rotations(turns),
        scales=to_floats(sizes) / 16 - 10,
        opacities=(to_floats(alphas[:, 0]) / 255).clamp(PACKED_NEAR, 1 - PACKED_NEAR).logit(),
        sh0=((to_floats(colors) / 255 - 0.5) / COLOR_SCALE)[:, None],
        shN=to_floats(bands[:, : 3 * BANDS[degree]]).sub_(128).div_(128).unflatten(1, (-1, 3))
        if degree
        else torch.zeros(count, 0, 3),
        antialiased=bool(header.flags & FLAG_ANTIALIASED),
    )
    return splats, _axes(records, path) if header.flags & FLAG_EXTENDED else OWN_AXES


def write_spz(splats: Splats, path: Path | str, *, version: int = SPZ_VERSIONS[0]) -> None:
    """Write SPZ: six times smaller than PLY or more, its numbers rounded."""
    content = pack_spz(_flipped(splats, 1.0, -1.0, -1.0), Path(path), version=version)
    write_file(path, content)


def pack_spz(splats: Splats, path: Path, *, version: int = SPZ_VERSIONS[0]) -> bytes:
    """The content of an SPZ file, for `path`, of splats in SPZ's own axes."""
    check_choice(version, "version of SPZ", SPZ_VERSIONS)
    reach = float(splats.means.abs().max()) if len(splats) else 0.0
    bits = [b for b in FRACTION if reach * 2**b <= SPZ_LARGEST_PLACE]
    if not bits:
        raise StyleSplatError(
            f"Cannot export to {path}: the splats reach {reach:.0f} units from the origin, which "
            "SPZ cannot express. Export a .ply."
        )
    data = to_gsply(replace(splats, opacities=splats.opacities.clamp(-SPZ_SURE, SPZ_SURE)))
    with TemporaryDirectory() as folder:  # gsply writes files alone
        packed = Path(folder) / "a.spz"
        gsply.write_spz(packed, data, version=max(version, 3), fractional_bits=max(bits))
        content = packed.read_bytes()
    if version == TABLES:
        return _marked(content) if splats.antialiased else content
    if version == 3 and not splats.antialiased:
        return content
    unpacked = gzip.decompress(content)
    unpacked = _marked(unpacked) if splats.antialiased else unpacked
    return gzip.compress(_of_version_2(unpacked, splats) if version == 2 else unpacked)


def _marked(content: bytes) -> bytes:
    """An SPZ file, without compression, that says that its splats are anti-aliased."""
    return content[:FLAGS] + bytes([content[FLAGS] | FLAG_ANTIALIASED]) + content[FLAGS + 1 :]


def _of_version_2(unpacked: bytes, splats: Splats) -> bytes:
    """Version 3 without its compression as version 2, whose rotations lack the real part.

    Half a turn about its own axis leaves a Gaussian as it is. Of four such quaternions, that of the
    largest real part loses least.
    """
    start = SPZ_HEADER.size + ROTATIONS * len(splats)
    w, x, y, z = F.normalize(splats.quats, dim=1).unbind(dim=1)
    turned = [(w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)]
    four = torch.stack([torch.stack(each, dim=1) for each in turned], dim=1)  # [N, 4, 4]
    quats = four[torch.arange(len(four)), four[..., 0].abs().argmax(dim=1)]
    imaginary = quats[:, 1:] * quats[:, :1].sign()
    rotations = (imaginary * 127.5 + 127.5).round().clamp(0, 255).byte()
    head = unpacked[:4] + struct.pack("<I", 2) + unpacked[8:start]
    return head + rotations.numpy().tobytes() + unpacked[start + 4 * len(splats) :]


def _positions(places: UInt8[np.ndarray, "N D"], header: _Header) -> Float[np.ndarray, "N 3"]:
    if header.version == HALF_FLOATS:
        return places.view("<f2").astype(np.float32)
    low, middle, high = np.moveaxis(places.reshape(-1, 3, 3).astype(np.int32), 2, 0)
    fixed = low | middle << 8 | (high ^ 128) - 128 << 16  # the highest bit is the sign
    return (fixed * 2.0**-header.fraction).astype(np.float32)


def _rotations(turns: UInt8[np.ndarray, "N 4"]) -> Float[Tensor, "N 4"]:
    """The index of the largest of x, y, z, w in two bits, then the others with their signs."""
    packed = torch.from_numpy(turns.copy().view("<u4")[:, 0].astype(np.int64))
    fields = torch.stack([packed >> shift for shift in (20, 10, 0)], dim=1)
    others = (fields & 511) * (PACKED_LARGEST / 511) * (1 - 2 * (fields >> 9 & 1))
    return from_smallest_three(packed >> 30, others.float())[:, [3, 0, 1, 2]]


def _coarse_rotations(turns: UInt8[np.ndarray, "N 3"]) -> Float[Tensor, "N 4"]:
    imaginary = to_floats(turns) / 127.5 - 1
    real = (1 - imaginary.square().sum(dim=1, keepdim=True)).clamp(min=0).sqrt()
    return torch.cat([real, imaginary], dim=1)


def _axes(records: bytes, path: Path | str) -> str:
    """The axes that the records of a file declare; a line names the others, which are skipped."""
    axes, skipped, start = OWN_AXES, list[str](), 0
    while start < len(records):
        kind, size = SPZ_RECORD.unpack_from(records, start)
        start += SPZ_RECORD.size + size
        if start > len(records):
            raise ValueError(f"its record 0x{kind:08X} ends after the file")
        if kind != AXES or size < 4:
            skipped.append(f"0x{kind:08X}")
            continue
        (number,) = struct.unpack_from("<I", records, start - size)
        if number > len(SPZ_NAMES):
            raise ValueError(f"it declares axes of number {number}, of which there are 16")
        axes = SPZ_NAMES[number - 1] if number else OWN_AXES
    if skipped:
        say(f"{path} has records that are not read here: {join_names(skipped)}.")
    return axes


def _in_ply_axes(splats: Splats, axes: str) -> Splats:
    """Splats of axes whose letters name the directions of x, y and z."""
    if axes[1] in OPPOSITE:  # y points forward or back
        splats = move_splats(splats, Frame(QUARTER_TURN))
        axes = axes[0] + axes[2] + OPPOSITE[axes[1]]
    x, y, z = (1.0 if one == other else -1.0 for one, other in zip(axes, PLY_AXES, strict=True))
    return _flipped(splats, x, y, z)


def _flipped(splats: Splats, x: float, y: float, z: float) -> Splats:
    """The same splats where axes of sign -1 point the other way, which may mirror them."""
    bands = [y, z, x, x * y, y * z, 1, x * z, 1, y, x * y * z, y, z, x, z, x]
    return replace(
        splats,
        means=splats.means * torch.tensor([x, y, z]),
        quats=splats.quats * torch.tensor([1, y * z, x * z, x * y]),
        shN=splats.shN * torch.tensor(bands)[: splats.shN.shape[1], None],
    )


def _sections(content: bytes) -> tuple[_Header, list[bytes], bytes]:
    """The header, the bytes of each attribute, and the records.

    A ValueError if the count does not fit the file, before memory is allocated for it.
    """
    packed = zlib.decompressobj(wbits=31) if content.startswith(GZIP) else None
    head = packed.decompress(content, SPZ_HEADER.size) if packed else content[: SPZ_HEADER.size]
    magic, *numbers = SPZ_HEADER.unpack(head)
    header = _Header(*numbers)
    if magic != MAGIC:
        raise ValueError("it has no SPZ header")
    if not HALF_FLOATS <= header.version <= TABLES or header.degree not in DEGREES:
        kind = f"version {header.version}, degree {header.degree}"
        raise ValueError(f"its SPZ header is of {kind}, which is not read here")
    if header.rows * SPZ_SMALLEST_ROW > SPZ_LARGEST_RATIO * len(content):
        fault = f"it claims {header.rows} Gaussians, which {len(content)} bytes cannot hold"
        raise ValueError(fault)
    sizes = [header.rows * width for width in header.widths]
    if packed is None and header.version == TABLES:
        return header, *_unpacked_streams(content, header.streams, sizes)
    rest = content[SPZ_HEADER.size :]  # without compression, as some tools write it
    if packed is not None:
        rest = packed.decompress(packed.unconsumed_tail, sum(sizes) + SPZ_EXTENSIONS)
        if not packed.eof or packed.unused_data:
            raise ValueError("it is cut off, or holds more than its header says")
    if len(rest) < sum(sizes):
        raise ValueError(f"it is cut off: {sum(sizes)} bytes should follow, {len(rest)} do")
    ends = np.cumsum([0, *sizes]).tolist()
    streams = [rest[start:end] for start, end in pairwise(ends)]
    return header, streams, rest[ends[-1] :]


def _unpacked_streams(content: bytes, count: int, sizes: list[int]) -> tuple[list[bytes], bytes]:
    """The streams of version 4, of which those without bytes are not there, and the records."""
    *_, table = TABLE.unpack_from(content)
    start = table + count * STREAM.size
    if count != sum(size > 0 for size in sizes) or not TABLE_HEADER <= table:
        raise ValueError("its table of streams does not fit its header")
    unpacked, entries = list[bytes](), iter(range(table, start, STREAM.size))
    for size in sizes:
        if not size:
            unpacked.append(b"")
            continue
        packed, announced = STREAM.unpack_from(content, next(entries))
        stream = content[start : start + packed]
        if announced != size or zstandard.frame_content_size(stream) not in (-1, size):
            raise ValueError("it holds more than its header says")
        unpacked.append(zstandard.ZstdDecompressor().decompress(stream, max_output_size=size))
        if len(unpacked[-1]) != size:
            raise ValueError("it is cut off")
        start += packed
    return unpacked, content[TABLE_HEADER:table]

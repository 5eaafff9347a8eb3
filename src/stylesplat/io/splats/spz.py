"""Splats as SPZ, Niantic's compressed format: gzip (versions 1 to 3) or zstd (version 4)."""

import gzip
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import gsply
import torch
import zstandard
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes
from stylesplat.io.splats.compressed_ply import from_gsply, to_gsply
from stylesplat.io.splats.splat_ply import BANDS
from stylesplat.scene.splats import Splats

SPZ_VERSIONS = (4, 3, 2)  # that are written; 3 is larger by a twelfth, 2 has coarser rotations
POSITION = 2**23 - 1  # largest fixed-point coordinate
FRACTION = range(1, 21)  # bits behind the point; 20 resolve a millionth
SURE = 30.0  # a logit beyond which the byte of an opacity is 0 or 255; exp(88) overflows
FLIP = torch.tensor([1.0, -1.0, -1.0])  # PLY's x right, y down to SPZ's x right, y up, and back
FLIP_SH = torch.tensor([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])  # per band
GZIP = b"\x1f\x8b"
HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, degree, fraction, flags, 0
TABLE = struct.Struct("<4sIIBBBBI")  # version 4: the same, but number of streams, their table
STREAM = struct.Struct("<QQ")  # bytes before and after compression
ROTATIONS = 16  # bytes of a Gaussian before its rotation: place, opacity, colour, size
SMALLEST_ROW = 19  # bytes of a Gaussian without higher bands, before compression
EXTENSIONS = 2**20  # bytes that may follow the Gaussians
LARGEST_RATIO = 200  # of compression: real files reach 20, zeros 1000


def read_spz(path: Path | str) -> Splats:
    """Read an SPZ file into PLY's axes."""
    return _flip(unpack_spz(read_bytes(path)))


def unpack_spz(content: bytes) -> Splats:
    """Read the content of an SPZ file in SPZ's own axes."""
    _check(content)
    with TemporaryDirectory() as folder:  # gsply reads files alone
        unpacked = Path(folder) / "a.spz"
        unpacked.write_bytes(content)
        try:
            return from_gsply(gsply.read_spz(unpacked))
        except ValueError as error:  # gsply ends with the file's name
            raise ValueError(str(error).removesuffix(f": {unpacked}")) from error


def write_spz(splats: Splats, path: Path | str, *, version: int = SPZ_VERSIONS[0]) -> None:
    """Write SPZ: six times smaller than PLY or more, its numbers rounded."""
    content = pack_spz(_flip(splats), Path(path), version=version)
    with atomic_path(path) as draft:
        draft.write_bytes(content)


def pack_spz(splats: Splats, path: Path, *, version: int = SPZ_VERSIONS[0]) -> bytes:
    """The content of an SPZ file, for `path`, of splats in SPZ's own axes."""
    check_choice(version, "version of SPZ", SPZ_VERSIONS)
    reach = float(splats.means.abs().max()) if len(splats) else 0.0
    bits = [b for b in FRACTION if reach * 2**b <= POSITION]
    if not bits:
        raise StyleSplatError(
            f"Cannot export to {path}: the splats reach {reach:.0f} units from the origin, which "
            "SPZ cannot express. Export a .ply."
        )
    data = to_gsply(replace(splats, opacities=splats.opacities.clamp(-SURE, SURE)))
    with TemporaryDirectory() as folder:  # gsply writes files alone
        packed = Path(folder) / "a.spz"
        gsply.write_spz(packed, data, version=max(version, 3), fractional_bits=max(bits))
        content = packed.read_bytes()
    return _of_version_2(content, splats) if version == 2 else content


def _of_version_2(content: bytes, splats: Splats) -> bytes:
    """An SPZ file of version 3 as one of version 2, whose rotations lack the real part.

    Half a turn about its own axis leaves a Gaussian as it is. Of four such quaternions, that of the
    largest real part loses least.
    """
    unpacked = gzip.decompress(content)
    start = HEADER.size + ROTATIONS * len(splats)
    w, x, y, z = F.normalize(splats.quats, dim=1).unbind(dim=1)
    turned = [(w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)]
    four = torch.stack([torch.stack(each, dim=1) for each in turned], dim=1)  # [N, 4, 4]
    quats = four[torch.arange(len(four)), four[..., 0].abs().argmax(dim=1)]
    imaginary = quats[:, 1:] * quats[:, :1].sign()
    rotations = (imaginary * 127.5 + 127.5).round().clamp(0, 255).byte()
    head = unpacked[:4] + struct.pack("<I", 2) + unpacked[8:start]
    return gzip.compress(head + rotations.numpy().tobytes() + unpacked[start + 4 * len(splats) :])


def _flip(splats: Splats) -> Splats:
    bands = splats.shN.shape[1]
    return replace(
        splats,
        means=splats.means * FLIP,
        quats=torch.cat([splats.quats[:, :2], -splats.quats[:, 2:]], dim=1),
        shN=splats.shN * FLIP_SH[:bands, None],
    )


def _check(content: bytes) -> None:
    """Raise a ValueError unless the count in the header fits the file: gsply allocates by it."""
    packed = zlib.decompressobj(wbits=31) if content.startswith(GZIP) else None
    head = packed.decompress(content, HEADER.size) if packed else content[: HEADER.size]
    magic, version, count, degree, *_ = HEADER.unpack(head)
    if magic != b"NGSP" or degree >= len(BANDS):
        raise ValueError("it has no SPZ header")
    if count * SMALLEST_ROW > LARGEST_RATIO * len(content):
        raise ValueError(f"it claims {count} Gaussians, which {len(content)} bytes cannot hold")
    if packed:
        rows = count * (SMALLEST_ROW + (version >= 3) + 3 * BANDS[degree])
        packed.decompress(packed.unconsumed_tail, rows + EXTENSIONS)
        if not packed.eof or packed.unused_data:
            raise ValueError("it is cut off, or holds more than its header says")
        return
    *_, streams, table = TABLE.unpack_from(content)
    start = table + streams * STREAM.size
    for index in range(streams):
        size, unpacked = STREAM.unpack_from(content, table + index * STREAM.size)
        if zstandard.frame_content_size(content[start : start + size]) not in (-1, unpacked):
            raise ValueError("it holds more than its header says")
        start += size

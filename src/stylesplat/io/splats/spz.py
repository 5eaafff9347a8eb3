"""Splats as SPZ, Niantic's compressed format: gzip (versions 1 to 3) or zstd (version 4)."""

import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import gsply
import torch
import zstandard

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes
from stylesplat.io.splats.compressed_ply import from_gsply, to_gsply
from stylesplat.io.splats.splat_ply import BANDS
from stylesplat.scene.splats import Splats

WRITTEN = 4  # version; 3 is larger by a twelfth
POSITION = 2**23 - 1  # largest fixed-point coordinate
FRACTION = range(1, 21)  # bits behind the point; 20 resolve a millionth
SURE = 30.0  # a logit beyond which the byte of an opacity is 0 or 255; exp(88) overflows
FLIP = torch.tensor([1.0, -1.0, -1.0])  # PLY's x right, y down to SPZ's x right, y up, and back
FLIP_SH = torch.tensor([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])  # per band
GZIP = b"\x1f\x8b"
HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, degree, fraction, flags, 0
TABLE = struct.Struct("<4sIIBBBBI")  # version 4: the same, but number of streams, their table
STREAM = struct.Struct("<QQ")  # bytes before and after compression
SMALLEST_ROW = 19  # bytes of a Gaussian without higher bands, before compression
EXTENSIONS = 2**20  # bytes that may follow the Gaussians
LARGEST_RATIO = 200  # of compression: real files reach 20, zeros 1000


def read_spz(path: Path | str) -> Splats:
    """Read an SPZ file into PLY's axes."""
    return _flip(spz_within(read_bytes(path), Path(path)))


def spz_within(content: bytes, path: Path) -> Splats:
    """Read the content of an SPZ file, perhaps embedded in another `path`, in SPZ's own axes."""
    try:
        _check(content)
        with TemporaryDirectory() as folder:  # gsply reads files alone
            unpacked = Path(folder) / "a.spz"
            unpacked.write_bytes(content)
            data = gsply.read_spz(unpacked)
    except (OSError, ValueError, struct.error, zlib.error, zstandard.ZstdError) as error:
        fault = re.sub(r": [^:]*\.spz$", "", str(error))  # gsply ends with a name
        raise StyleSplatError(f"Cannot read {path} as SPZ: {fault}. Export it again.") from error
    return from_gsply(data, path)


def write_spz(splats: Splats, path: Path | str) -> None:
    """Write SPZ of version 4: six times smaller than PLY or more, its numbers rounded."""
    reach = float(splats.means.abs().max()) if len(splats) else 0.0
    bits = [b for b in FRACTION if reach * 2**b <= POSITION]
    if not bits:
        raise StyleSplatError(
            f"Cannot export to {path}: the splats reach {reach:.0f} units from the origin, which "
            "SPZ cannot express. Export a .ply."
        )
    flipped = _flip(splats)
    data = to_gsply(replace(flipped, opacities=flipped.opacities.clamp(-SURE, SURE)))
    with atomic_path(path) as draft:
        gsply.write_spz(draft, data, version=WRITTEN, fractional_bits=max(bits))


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

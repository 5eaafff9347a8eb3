"""Files of GaussianSplats3D, made by hand: nothing of ours writes them."""

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from stylesplat.io.splats.packing import unit_quats
from stylesplat.scene.splats import SH_C0, Splats

BLOCK, BUCKET = 5.0, 8  # side of a bucket's cube, and Gaussians of a full bucket
LOW, HIGH = -1.2, 1.4  # of higher bands in bytes


def header(count: int, level: int, sections: int) -> bytes:
    counts = (sections, sections, count, count)
    start = struct.pack("<4B4IHxx3f2f", 0, 1, 0, 0, *counts, level, 0, 0, 0, LOW, HIGH)
    return start.ljust(4096, b"\0")


def section_header(count: int, full: int, partial: int, level: int, degree: int) -> bytes:
    if level == 0:
        start = struct.pack("<4IfHxx4IH", count, count, 0, 0, 0, 0, 0, 0, 0, 0, degree)
    else:
        sizes = (count, count, BUCKET, full + partial)
        start = struct.pack("<4IfHxx4IH", *sizes, BLOCK, 12, 32767, 0, full, partial, degree)
    return start.ljust(1024, b"\0")


def row(splats: Splats, n: int, centre: np.ndarray, level: int, degree: int) -> bytes:
    mean, sizes = splats.means[n].numpy(), splats.scales[n].exp().numpy()
    quat = unit_quats(splats.quats)[n].numpy()
    rgb = (0.5 + SH_C0 * splats.sh0[n, 0].numpy()).clip(0, 1)
    rgba = np.append(rgb, torch.sigmoid(splats.opacities[n])) * 255
    bands = splats.shN[n].numpy()
    higher = [bands[:3].T, bands[3:8].T][:degree]  # a degree after the other, red first
    rest = np.concatenate([each.ravel() for each in higher]) if higher else np.zeros(0)
    real = "<f4" if level == 0 else "<f2"
    if level > 0:
        mean = np.round((mean - centre) * 32767 / (BLOCK / 2)) + 32767
    if level == 2:
        rest = np.floor((rest - LOW) / (HIGH - LOW) * 255).clip(0, 255)
    parts = (
        mean.astype("<f4" if level == 0 else "<u2"),
        sizes.astype(real),
        quat.astype(real),
        np.floor(rgba).astype(np.uint8),
        rest.astype("u1" if level == 2 else real),
    )
    return b"".join(part.tobytes() for part in parts)


def write_ksplat(path: Path, parts: list[Splats], level: int, degree: int) -> Path:
    heads, bodies = list[bytes](), list[bytes]()
    for splats in parts:
        full, rest = divmod(len(splats), BUCKET)
        sizes = [BUCKET] * full + [rest - 1, 1]  # two partly filled buckets
        ends = np.cumsum([0, *sizes])
        centres = [splats.means[a:b].mean(dim=0).numpy() for a, b in pairwise(ends)]
        body = b""
        if level > 0:
            body += struct.pack("<2I", rest - 1, 1) + np.array(centres, "<f4").tobytes()
        of_row = np.repeat(np.arange(len(sizes)), sizes)
        body += b"".join(
            row(splats, n, centres[of_row[n]], level, degree) for n in range(len(splats))
        )
        heads.append(section_header(len(splats), full, 2, level, degree))
        bodies.append(body)
    count = sum(map(len, parts))
    path.write_bytes(b"".join([header(count, level, len(parts)), *heads, *bodies]))
    return path

"""Splats as SOG, PlayCanvas's format of pictures, read.

The format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.json_files import json_object
from stylesplat.io.kinds import SOG_META
from stylesplat.io.splats.lossless_webp import webp_pixels, webp_size
from stylesplat.io.splats.rotations import LARGEST, whole_quats
from stylesplat.io.splats.sog_members import Members, sog_members
from stylesplat.io.splats.sog_meta import Codebook, Palette, SogMeta, sog_meta
from stylesplat.io.splats.splat_ply import check_splats
from stylesplat.scene.splats import Splats

FIRST_TAG = 252  # alpha of a rotation whose first part is largest; 255 if it is the last
COLUMNS = 64  # entries of the palette in a row of its picture
SURE = 1e-6  # from 0 and 1: opacities of 0 and 1 have no logit; splat-transform's bound
MOST_PER_BYTE = 4  # Gaussians; real files need several bytes for one
SMALL = 2**16  # Gaussians that need little memory, whatever is said of them
SPARE = 2  # pixels for a Gaussian; SMALL more are fine

Texels = UInt8[np.ndarray, "N 4"]


def read_sog(path: Path | str) -> Splats:
    """Read a bundle, or the folder of a meta.json, into PLY's conventions, its rows in order.

    Raises:
        StyleSplatError: If a file is missing or damaged, a picture is not as large as it has to
            be, or it claims more Gaussians than it can hold.
    """
    path = Path(path)
    members = sog_members(path)
    where = path if path.name == SOG_META else path / SOG_META
    meta = sog_meta(json_object(members(SOG_META), where), f"Cannot read {path}")
    pictures = _Pictures(path, meta, members)
    try:
        splats = _splats(meta, pictures)
    except ValueError as error:
        raise _cannot_read(path, str(error)) from error
    return check_splats(splats, path)


class _Pictures:
    """The pictures, loaded as they are and decoded when their sizes are found fit."""

    def __init__(self, path: Path, meta: SogMeta, members: Members) -> None:
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

    def palette(self, declared: Palette) -> Texels:
        """The pixels of the palette, all those of an entry after the other."""
        bands = (declared.bands + 1) ** 2 - 1
        size = (COLUMNS * bands, -(-declared.count // COLUMNS))
        return self._pixels(declared.files[0], size)[: declared.count * bands]

    def _pixels(self, name: str, size: tuple[int, int]) -> Texels:
        found = self._size(name)
        if found != size:
            told = "{} x {}".format
            raise ValueError(
                f"{brief(name)!r} has {told(*found)} pixels, where {told(*size)} are due"
            )
        with self._naming(name):
            return webp_pixels(self.files[name]).reshape(-1, 4)

    def _size(self, name: str) -> tuple[int, int]:
        with self._naming(name):
            return webp_size(self.files[name])

    @contextmanager
    def _naming(self, name: str) -> Iterator[None]:
        try:
            yield
        except ValueError as error:
            raise _cannot_read(self.path, f"{brief(name)!r}: {error}") from error


def _splats(meta: SogMeta, pictures: _Pictures) -> Splats:
    colors = pictures.rows(meta.sh0.files[0])
    alphas = torch.from_numpy(colors[:, 3] / np.float32(255))
    splats = Splats(
        means=_means(meta, pictures),
        quats=_quats(pictures.rows(meta.quats.files[0])),
        scales=_meant(pictures.rows(meta.scales.files[0])[:, :3], meta.scales.codebook),
        opacities=alphas.clamp(SURE, 1 - SURE).logit(),
        sh0=_meant(colors[:, None, :3], meta.sh0.codebook),
        shN=torch.zeros(meta.count, 0, 3),
    )
    return splats if meta.shN is None else replace(splats, shN=_bands(meta.shN, pictures))


def _means(meta: SogMeta, pictures: _Pictures) -> Float[Tensor, "N 3"]:
    low, high = (pictures.rows(name)[:, :3].astype(np.float64) for name in meta.means.files)
    start, end = np.array(meta.means.mins), np.array(meta.means.maxs)
    places = start + (end - start) * (low + 256 * high) / 65535
    return torch.from_numpy((np.sign(places) * np.expm1(np.abs(places))).astype(np.float32))


def _quats(texels: Texels) -> Float[Tensor, "N 4"]:
    bad = int((texels[:, 3] < FIRST_TAG).sum())
    if bad:
        raise ValueError(f"{bad} rotations do not tell their largest part")
    largest = torch.from_numpy(texels[:, 3].astype(np.int64) - FIRST_TAG)
    others = torch.from_numpy(texels[:, :3] / np.float32(255)) * 2 - 1
    return whole_quats(largest, others * LARGEST)


def _bands(declared: Palette, pictures: _Pictures) -> Float[Tensor, "N _ 3"]:
    choices = pictures.rows(declared.files[1]).astype(np.int64)
    labels = torch.from_numpy(choices[:, 0] + 256 * choices[:, 1])
    bad = int((labels >= declared.count).sum())
    if bad:
        raise ValueError(f"{bad} Gaussians have colours beyond the palette's {declared.count}")
    entries = _meant(pictures.palette(declared)[:, :3], declared.codebook)
    return entries.unflatten(0, (declared.count, -1))[labels]


def _meant(texels: UInt8[np.ndarray, "*B"], codebook: Codebook) -> Float[Tensor, "*B"]:
    """The numbers that bytes stand for."""
    bad = int((texels >= len(codebook)).sum())
    if bad:
        raise ValueError(f"{bad} bytes are beyond a codebook of {len(codebook)}")
    return torch.from_numpy(np.array(codebook, np.float32)[texels])


def _cannot_read(path: Path, fault: str) -> StyleSplatError:
    return StyleSplatError(f"Cannot read {path}: {fault}. Export it again.")

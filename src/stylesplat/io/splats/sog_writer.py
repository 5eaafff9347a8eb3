"""Splats as SOG, PlayCanvas's format of pictures, written.

The format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import strict_json
from stylesplat.io.kinds import SOG_META
from stylesplat.io.splats.clusters import clustered
from stylesplat.io.splats.codebooks import codebook_of, coded
from stylesplat.io.splats.lossless_webp import LONGEST, webp_of
from stylesplat.io.splats.morton import morton_order
from stylesplat.io.splats.rotations import LARGEST, smallest_three
from stylesplat.io.splats.sog_members import write_bundle
from stylesplat.io.splats.sog_meta import PALETTE, VERSION
from stylesplat.io.splats.sog_reader import COLUMNS, FIRST_TAG
from stylesplat.io.splats.splat_ply import splat_fault
from stylesplat.scene.splats import Splats

BLOCK = 4  # sides are multiples of it, as splat-transform's
OPAQUE = 255  # alpha where it means nothing

Texels = UInt8[np.ndarray, "M D"]


def write_sog(splats: Splats, path: Path | str) -> None:
    """Write a bundle, its rows in Morton order and its numbers rounded.

    Places have 16 bits along each axis, finest near the origin; rotations and opacities 8; sizes
    and colours are one of 256 values that fit these splats best; higher bands of colour are one
    of a palette of 65536 or, for fewer Gaussians, the next lower power of two of their number.

    Raises:
        StyleSplatError: If numbers are not finite, there are too many Gaussians, or the file
            cannot be written.
    """
    path = Path(path)
    fault = splat_fault(splats) if len(splats) else None
    if fault:
        raise StyleSplatError(f"Cannot export to {path}: {fault}. Export a .ply.")
    splats = splats[morton_order(splats.means)]
    bundle = _Bundle(*_sides(len(splats), path))
    about = {"version": VERSION, "asset": {"generator": "StyleSplat"}, "count": len(splats)}
    about |= {"means": _means(splats, bundle), "scales": _scales(splats, bundle)}
    about |= {"quats": _quats(splats, bundle), "sh0": _colors(splats, bundle)}
    if len(splats) and splats.shN.shape[1]:
        about["shN"] = _bands(splats, bundle)
    bundle.files[SOG_META] = strict_json(about).encode()
    write_bundle(bundle.files, path)


@dataclass
class _Bundle:
    """The files so far, and the size of the pictures that have a pixel for each Gaussian."""

    width: int
    height: int
    files: dict[str, bytes] = field(default_factory=dict)

    def add(self, name: str, texels: Texels, width: int = 0, height: int = 0) -> str:
        """Make a picture, its rest 0; missing channels are 0, alpha is opaque."""
        width, height = width or self.width, height or self.height
        pixels = np.zeros((height * width, 4), np.uint8)
        pixels[:, 3] = OPAQUE
        pixels[: len(texels), : texels.shape[1]] = texels
        self.files[name] = webp_of(pixels.reshape(height, width, 4))
        return name


def _sides(count: int, path: Path) -> tuple[int, int]:
    width = max(1, math.ceil(math.sqrt(count) / BLOCK)) * BLOCK
    height = max(1, math.ceil(count / width / BLOCK)) * BLOCK
    if width > LONGEST:
        raise StyleSplatError(
            f"Cannot export to {path}: {count} Gaussians are more than its pictures can hold. "
            "Export a .ply."
        )
    return width, height


def _means(splats: Splats, bundle: _Bundle) -> dict[str, Any]:
    places = splats.means.double().numpy()
    places = np.sign(places) * np.log1p(np.abs(places))
    low = places.min(axis=0, initial=np.inf) if len(places) else np.zeros(3)
    high = places.max(axis=0, initial=-np.inf) if len(places) else np.zeros(3)
    steps = np.divide(places - low, high - low, where=high > low, out=np.zeros_like(places))
    steps = (steps * 65535).round().astype(np.uint16)
    files = [
        bundle.add("means_l.webp", (steps & 255).astype(np.uint8)),
        bundle.add("means_u.webp", (steps >> 8).astype(np.uint8)),
    ]
    return {"mins": low, "maxs": high, "files": files}


def _quats(splats: Splats, bundle: _Bundle) -> dict[str, Any]:
    largest, others = smallest_three(splats.quats)
    parts = _bytes((others / LARGEST + 1) / 2)
    tags = (largest + FIRST_TAG).byte().numpy()
    return {"files": [bundle.add("quats.webp", np.column_stack([parts, tags]))]}


def _scales(splats: Splats, bundle: _Bundle) -> dict[str, Any]:
    codebook = codebook_of(splats.scales.numpy())
    texels = coded(splats.scales.numpy(), codebook)
    return {"codebook": codebook, "files": [bundle.add("scales.webp", texels)]}


def _colors(splats: Splats, bundle: _Bundle) -> dict[str, Any]:
    colors = splats.sh0[:, 0].numpy()
    codebook, alphas = codebook_of(colors), _bytes(torch.sigmoid(splats.opacities))
    texels = np.column_stack([coded(colors, codebook), alphas])
    return {"codebook": codebook, "files": [bundle.add("sh0.webp", texels)]}


def _bands(splats: Splats, bundle: _Bundle) -> dict[str, Any]:
    most = min(PALETTE, 2 ** int(math.log2(len(splats))))
    entries, labels = clustered(splats.shN.flatten(1).numpy(), most)
    codebook = codebook_of(entries)
    count, bands = len(entries), splats.shN.shape[1]
    texels = coded(entries, codebook).reshape(count * bands, 3)
    width, height = COLUMNS * bands, math.ceil(count / COLUMNS)
    choices = np.column_stack([labels & 255, labels >> 8]).astype(np.uint8)
    files = [
        bundle.add("shN_centroids.webp", texels, width, height),
        bundle.add("shN_labels.webp", np.pad(choices, ((0, 0), (0, 1)))),
    ]
    return {"count": count, "bands": splats.sh_degree, "codebook": codebook, "files": files}


def _bytes(shares: torch.Tensor) -> UInt8[np.ndarray, "..."]:
    return (shares * 255).round().clamp(0, 255).byte().numpy()

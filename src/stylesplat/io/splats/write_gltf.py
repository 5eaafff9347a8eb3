"""Splats as glTF 2.0 with Khronos' KHR_gaussian_splatting: `.glb`, or `.gltf`, which is all text.

Programs that do not know the extension show a cloud of coloured points. The splats are written as
they are, in their own frame; the node that places them turns them to glTF's y-up world.
"""

import base64
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.splats.gltf_file import (
    BINARY,
    CHUNK,
    DISPLAYED,
    HEADER,
    JSON,
    MAGIC,
    SPLATTING,
    VERSION,
    WIDTHS,
    attribute,
    harmonic,
    higher_bands,
)
from stylesplat.io.splats.packing import unit_quats
from stylesplat.io.splats.read_gltf import HALF_TURN_XYZW, POINTS, SMALLEST
from stylesplat.io.splats.splat_ply import REMEDY, splat_fault
from stylesplat.scene.splats import SH_C0, Splats

FLOAT, SHORT = 5126, 5123
SIZES = {FLOAT: 4, SHORT: 2}  # bytes
VERTICES = 34962  # the target of a view that holds attributes
MAX_SIZE = 2**32 - 1  # bytes of a GLB
GENERATOR = "StyleSplat"
EMBEDDED = "data:application/octet-stream;base64,"


class Column(NamedTuple):
    """An attribute, whose values are computed when they are written."""

    name: str
    kind: str
    component: int
    values: Callable[[], Tensor]

    def size(self, count: int) -> int:
        """Bytes of so many rows."""
        return count * WIDTHS[self.kind] * SIZES[self.component]


def write_glb(splats: Splats, path: Path | str) -> None:
    """Write a GLB: float32 throughout, rotations as unit quaternions, colours of all degrees.

    glTF stores opacities and standard deviations, not logits and logarithms; when they are read
    again, opacities differ by at most 1e-7 and scales by 1e-6.
    """
    path = Path(path)
    columns, document = _parts(splats, path)
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = document["buffers"][0]["byteLength"]
    whole = HEADER.size + 2 * CHUNK.size + len(text) + size
    if whole > MAX_SIZE:
        raise StyleSplatError(
            f"Cannot export to {path}: it would have {whole} bytes, a GLB has {MAX_SIZE} at most. "
            "Export a .ply, or leave out degrees of colour (`--sh-degree 0`)."
        )
    with atomic_path(path) as draft, draft.open("wb") as file:
        file.write(HEADER.pack(MAGIC, VERSION, whole) + CHUNK.pack(len(text), JSON) + text)
        file.write(CHUNK.pack(size, BINARY))
        file.writelines(_bytes(columns))


def write_gltf(splats: Splats, path: Path | str) -> None:
    """Write the same as JSON with the numbers in base64: a third larger, still one file."""
    path = Path(path)
    columns, document = _parts(splats, path)
    document["buffers"][0]["uri"] = EMBEDDED
    before, after = json.dumps(document, indent=1).encode().split(EMBEDDED.encode())
    with atomic_path(path) as draft, draft.open("wb") as file:
        file.write(before + EMBEDDED.encode())
        file.writelines(_as_text(_bytes(columns)))
        file.write(after)


def _parts(splats: Splats, path: Path) -> tuple[list[Column], dict[str, Any]]:
    """The attributes, and the JSON that describes them."""
    fault = splat_fault(splats) if len(splats) else None
    if fault:
        raise StyleSplatError(f"Cannot export to {path}: {fault}. {REMEDY}")
    if not len(splats):
        raise StyleSplatError(
            f"Cannot export to {path}: there are no Gaussians, and glTF has one at least. "
            "Export a .ply."
        )
    columns = _columns(splats)
    return columns, _document(columns, splats)


def _bytes(columns: list[Column]) -> Iterator[memoryview]:
    for column in columns:
        yield np.ascontiguousarray(column.values().numpy()).data.cast("B")


def _as_text(pieces: Iterable[memoryview]) -> Iterator[bytes]:
    """Base64 of the joined pieces; three bytes become four letters."""
    left = b""
    for piece in pieces:
        joined = left + piece
        whole = len(joined) - len(joined) % 3
        yield base64.b64encode(memoryview(joined)[:whole])
        left = joined[whole:]
    yield base64.b64encode(left)


def _columns(splats: Splats) -> list[Column]:
    """The attributes in their order; each size is a multiple of four, as the format demands."""
    colors = [splats.sh0[:, 0], *splats.shN.unbind(dim=1)]
    names = [harmonic(0, 0), *higher_bands(splats.sh_degree)]
    return [
        Column("POSITION", "VEC3", FLOAT, lambda: splats.means),
        Column("COLOR_0", "VEC4", SHORT, lambda: _fallback(splats)),
        Column(
            attribute("ROTATION"), "VEC4", FLOAT, lambda: unit_quats(splats.quats)[:, [1, 2, 3, 0]]
        ),
        Column(attribute("SCALE"), "VEC3", FLOAT, lambda: splats.scales.exp().clamp_(min=SMALLEST)),
        Column(attribute("OPACITY"), "SCALAR", FLOAT, splats.opacities.sigmoid),
        *(
            Column(name, "VEC3", FLOAT, lambda color=color: color)
            for name, color in zip(names, colors, strict=True)
        ),
    ]


def _xyzw(splats: Splats) -> Tensor:
    return unit_quats(splats.quats)[:, [1, 2, 3, 0]]


def _fallback(splats: Splats) -> Shaped[Tensor, "N 4"]:
    """Linear colours and alpha for programs that draw points."""
    shown = (SH_C0 * splats.sh0[:, 0] + 0.5).clamp_(0, 1)
    linear = torch.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)  # sRGB
    rgba = torch.cat([linear, splats.opacities.sigmoid()[:, None]], dim=1)
    return (rgba * 65535).round_().to(torch.uint16)


def _document(columns: list[Column], splats: Splats) -> dict[str, Any]:
    views, accessors, offset = [], [], 0
    for index, column in enumerate(columns):
        size = column.size(len(splats))
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": size, "target": VERTICES})
        accessors.append(
            {
                "bufferView": index,
                "componentType": column.component,
                "count": len(splats),
                "type": column.kind,
            }
        )
        offset += size
    accessors[0] |= {  # of the places, as the format demands
        "min": splats.means.amin(dim=0).tolist(),
        "max": splats.means.amax(dim=0).tolist(),
    }
    accessors[1]["normalized"] = True
    splatting = {
        "kernel": "ellipse",
        "colorSpace": DISPLAYED,
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "attributes": {column.name: index for index, column in enumerate(columns)},
        "mode": POINTS,
        "extensions": {SPLATTING: splatting},
    }
    return {
        "asset": {"version": f"{VERSION}.0", "generator": GENERATOR},
        "extensionsUsed": [SPLATTING],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": HALF_TURN_XYZW}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }

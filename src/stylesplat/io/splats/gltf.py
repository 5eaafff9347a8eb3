"""Splats in glTF 2.0 files (`.glb`, `.gltf`) with Khronos' KHR_gaussian_splatting.

The extension (https://github.com/KhronosGroup/glTF, extensions/2.0/Khronos; the release candidate
of April 2026) has standard deviations and opacities where PLY has logarithms and logits; its
harmonics are the INRIA code's. Programs that do not know it show a cloud of coloured points.
"""

import base64
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.atomic import atomic_path, write_file
from stylesplat.io.splats.gltf_file import (
    BYTE,
    DISPLAYED,
    GL_FLOAT,
    GLB_KINDS,
    GLB_VERSION,
    SHORT,
    SPLATTING,
    Gltf,
    Primitive,
    Splatting,
    attribute,
    glb_head,
    glb_size,
    harmonics,
    open_gltf,
    padded_json,
    placed_nodes,
)
from stylesplat.io.splats.packing import PACKED_SMALLEST, logits, unit_quats
from stylesplat.io.splats.splat_ply import BANDS, joined, refuse_faulty
from stylesplat.io.splats.spz import OWN_AXES, SPZ_LARGEST_RATIO, pack_spz, unpack_spz
from stylesplat.progress import say
from stylesplat.scene.frames import Frame, move_splats, similarity_frame
from stylesplat.scene.splats import Splats, linear_rgb, rgb_from_sh0
from stylesplat.scene.world_offset import Offset

SPZ = (f"{SPLATTING}_compression_spz_2", f"{SPLATTING}_compression_spz")  # now, and before
GLTF_SMALLEST_ROW = 12  # bytes of a Gaussian whose attributes all share three numbers
OF_FIRST_DRAFT = re.compile(r"splat-transform v?(\d+)\.(\d+)")
FIRST_LINEAR = (2, 7)  # version of splat-transform, June 2026
MOST_NEGATIVE = 0.5  # share of scales, beyond which they are logarithms: a unit is large for splats
GLTF_DRAFT = "release candidate of April 2026: linear scales"  # of the extension, that we write
# glTF's x left, y up, z forward to our (COLMAP's) x right, y down, z forward, and back
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
HALF_TURN_XYZW = [0.0, 0.0, 1.0, 0.0]
VERSION_INSIDE = 2  # of SPZ, which the extension is named after
GLTF_POINTS = 0  # the mode of a primitive that is drawn as points
KINDS_OF = {torch.float32: GL_FLOAT, torch.uint16: SHORT, torch.uint8: BYTE}
VERTICES = 34962  # the target of a view that holds attributes
MAX_SIZE = 2**32 - 1  # bytes of a GLB


def read_gltf(path: Path | str) -> Splats:
    """Read the splats that a glTF file shows, into PLY's axes.

    The transforms of the nodes are applied, and the world is turned by half about z: glTF's has y
    up, that of COLMAP, INRIA's code and `import` has y down. So a file that StyleSplat wrote comes
    back as it was, and one that PlayCanvas made of a PLY has that PLY's frame. Several sets of
    splats become one.
    """
    gltf = open_gltf(Path(path))
    parts, count = list[Splats](), 0
    for primitive, frame in _placed_splats(gltf):
        part = _splats(gltf, primitive)
        if frame is not None:  # in 64 bits, as the shift may be too large for 32
            part = move_splats(replace(part, means=part.means.double()), frame)
        parts.append(part)
        count += len(part)
        ratio = 1 if _spz_view(primitive) is None else SPZ_LARGEST_RATIO
        if count * GLTF_SMALLEST_ROW > gltf.size * ratio:
            raise ValueError(f"it shows {count} Gaussians, which {gltf.size} bytes cannot hold")
    return joined(parts)


def _splats(gltf: Gltf, primitive: Primitive) -> Splats:
    """The splats of a primitive, in its own frame."""
    splatting = primitive.extensions.splatting
    assert splatting is not None
    if splatting.kernel != "ellipse":
        raise ValueError(f"its splats are no ellipses, but {shorten(splatting.kernel)!r}")
    if splatting.color_space != DISPLAYED:
        say(
            f"{gltf.path} has its colours in {shorten(splatting.color_space)!r}: they are read as "
            f"{DISPLAYED}, so they may look darker."
        )
    known = Splatting()
    for name in ("projection", "sorting_method"):
        value = getattr(splatting, name)
        if value != getattr(known, name):
            say(f"{gltf.path} asks for the {name.replace('_', ' ')} {shorten(value)!r}: left out.")
    view = _spz_view(primitive)
    if view is not None:  # its numbers are in the axes of the primitive, unlike those of a `.spz`
        splats, axes = unpack_spz(bytes(gltf.view(view, "SPZ")[0]), gltf.path)
        if axes != OWN_AXES:
            say(f"{gltf.path} has SPZ that declares the axes {axes}: its mesh's are taken.")
        return splats
    unread = [name for name in splatting.extensions if "compression" in name]
    if unread:
        fault = f"its splats are compressed ({unread[0]:.60}), which is not read here"
        raise ValueError(f"{fault}. Export it without compression, or as .ply or .spz")

    means = torch.from_numpy(gltf.rows(primitive, "POSITION", 3))

    def column(name: str, width: int) -> Float[Tensor, "N D"]:
        rows = gltf.rows(primitive, name, width)
        if len(rows) != len(means):
            raise ValueError(f"its splats have {len(means)} positions, but {len(rows)} {name}")
        return torch.from_numpy(rows)

    quats, scales = column(attribute("ROTATION"), 4), column(attribute("SCALE"), 3)
    first, *higher = harmonics(_degree(gltf, primitive))
    shN = torch.empty(len(means), len(higher), 3)
    for band, name in enumerate(higher):
        shN[:, band] = column(name, 3)
    return Splats(
        means=means,
        quats=quats[:, [3, 0, 1, 2]],
        scales=_log_scales(gltf, scales),
        opacities=logits(column(attribute("OPACITY"), 1)[:, 0]),
        sh0=column(first, 3)[:, None],
        shN=shN,
    )


def _log_scales(gltf: Gltf, scales: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Logarithms of scales: the first draft, of January 2026, had these and so negative ones."""
    made = OF_FIRST_DRAFT.match(str(gltf.document.asset.get("generator", "")))
    written = made is not None and (int(made[1]), int(made[2])) < FIRST_LINEAR
    if written or (scales < 0).float().mean() > MOST_NEGATIVE:
        say(f"{gltf.path} has logarithms of scales, as {SPLATTING}'s first draft: read so.")
        return scales
    return scales.log()


def _spz_view(primitive: Primitive) -> int | None:
    """The view with the bytes of SPZ, if the splats are compressed so."""
    assert primitive.extensions.splatting is not None
    found = primitive.extensions.splatting.extensions
    return next((found[name].buffer_view for name in SPZ if name in found), None)


def _degree(gltf: Gltf, primitive: Primitive) -> int:
    """The highest degree whose harmonics are all there, with those of the degrees below."""
    there = {n for n in primitive.attributes if n.startswith(attribute("SH_DEGREE_"))}
    degrees = [degree for degree in range(len(BANDS)) if {*harmonics(degree)} <= there]
    degree = max(degrees, default=0)
    if there - {*harmonics(degree)}:
        say(f"{gltf.path} has colours of a higher degree than 3, or not all of one: left out.")
    return degree


def _placed_splats(gltf: Gltf) -> Iterator[tuple[Primitive, Frame | None]]:
    """The splats of the scene and the transform of each to our world; None leaves them as they are.

    If no node of the scene shows splats, all splats of the file count, without a transform.
    """
    shown = [
        (each, matrix)
        for node, matrix, _ in placed_nodes(gltf.document)
        if node.mesh is not None
        for each in _primitives(gltf, node.mesh)
    ]
    if not shown:
        meshes = range(len(gltf.document.meshes))
        shown = [(each, np.eye(4)) for mesh in meshes for each in _primitives(gltf, mesh)]
    if not shown:
        names = gltf.document.extensions_used
        other = next((name for name in names if "splat" in name and name != SPLATTING), None)
        if other is not None:
            fault = f"its splats are stored by {other:.60}, which is not read here"
            raise ValueError(f"{fault}. Export it with {SPLATTING} alone, or as .ply or .spz")
        raise ValueError(f"it holds no splats, but an ordinary model (no mesh has {SPLATTING})")
    for primitive, matrix in shown:
        pose = HALF_TURN @ matrix[:3, :3], HALF_TURN @ matrix[:3, 3]
        yield primitive, similarity_frame(*pose, "a node")


def _primitives(gltf: Gltf, mesh: int) -> list[Primitive]:
    meshes = gltf.document.meshes
    if mesh >= len(meshes):
        raise ValueError(f"a node shows mesh {mesh} of {len(meshes)}")
    return [each for each in meshes[mesh].primitives if each.extensions.splatting is not None]


def write_glb(splats: Splats, path: Path | str, *, spz: bool = False) -> None:
    """Write a GLB: float32 throughout, rotations as unit quaternions, colours of all degrees.

    glTF stores opacities and standard deviations, not logits and logarithms; when they are read
    again, opacities differ by at most 1e-7 and scales by 1e-6. With `spz` the numbers are those of
    SPZ, which readers have to know.
    """
    path = Path(path)
    document, parts = _document(splats, path, spz=spz)
    text, size = padded_json(document), document["buffers"][0]["byteLength"]
    whole = glb_size(text, size)
    if whole > MAX_SIZE:
        raise StyleSplatError(
            f"Cannot export to {path}: it would have {whole} bytes, a GLB has {MAX_SIZE} at most. "
            "Export a .ply, or leave out degrees of colour (`--sh-degree 0`)."
        )
    with atomic_path(path) as draft, draft.open("wb") as file:
        file.write(glb_head(text, size))
        file.writelines(parts)


def write_gltf(splats: Splats, path: Path | str, *, spz: bool = False) -> None:
    """Write the same as JSON with the numbers in base64: a third larger, still one file."""
    document, parts = _document(splats, Path(path), spz=spz)
    content = base64.b64encode(b"".join(parts)).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{content}"
    write_file(path, json.dumps(document, indent=1))


def half_turned_node(offset: Offset, *, as_matrix: bool = False) -> dict[str, list[float]]:
    """The transform from an offset of our world to glTF's; CesiumJS knows a matrix only."""
    shift = HALF_TURN @ offset + 0.0  # no -0
    if as_matrix:
        matrix = np.diag([*HALF_TURN.diagonal(), 1.0])
        matrix[:3, 3] = shift
        return {"matrix": matrix.T.ravel().tolist()}  # column-major
    return {"rotation": HALF_TURN_XYZW} | ({"translation": shift.tolist()} if any(offset) else {})


def _bytes(column: Shaped[Tensor, "N D"]) -> memoryview:
    return np.ascontiguousarray(column.numpy()).data.cast("B")


def _columns(splats: Splats, path: Path) -> dict[str, Shaped[Tensor, "N D"]]:
    """The attributes in their order; each size is a multiple of four, as the format demands."""
    refuse_faulty(splats, path)
    if not len(splats):
        raise StyleSplatError(
            f"Cannot export to {path}: there are no Gaussians, and glTF has one at least. "
            "Export a .ply."
        )
    opacities = splats.opacities.sigmoid()[:, None]
    # Linear colours and alpha for programs that draw points
    linear = linear_rgb(rgb_from_sh0(splats.sh0[:, 0]).clamp_(0, 1))
    points = torch.cat([linear, opacities], dim=1)
    bands = (splats.sh0[:, 0], *splats.shN.unbind(dim=1))
    return {
        "POSITION": splats.means,
        "COLOR_0": (points * 65535).round_().to(torch.uint16),
        attribute("ROTATION"): unit_quats(splats.quats)[:, [1, 2, 3, 0]],
        attribute("SCALE"): splats.scales.exp().clamp_(min=PACKED_SMALLEST),
        attribute("OPACITY"): opacities,
        **dict(zip(harmonics(splats.sh_degree), bands, strict=True)),
    }


def _document(
    splats: Splats, path: Path, *, spz: bool
) -> tuple[dict[str, Any], Sequence[bytes | memoryview]]:
    """The JSON that describes the attributes, and the parts of the binary chunk.

    With `spz` the accessors of the attributes have no content; there is none of those that the
    extension does not name, from which CesiumJS would take wrong numbers. CesiumJS takes SPZ's
    numbers to be in the mesh's axes.
    """
    columns = _columns(splats, path)
    if spz:
        packed = pack_spz(splats, path, version=VERSION_INSIDE)
        columns = _columns(unpack_spz(packed, path)[0], path)
        columns["COLOR_0"] = (columns["COLOR_0"].float() / 257).round_().to(torch.uint8)
        del columns[attribute("OPACITY")], columns[harmonics(0)[0]]
        parts = [packed + bytes(-len(packed) % 4)]
        views: list[dict[str, Any]] = [{"buffer": 0, "byteLength": len(packed)}]
    else:
        parts = [*map(_bytes, columns.values())]
        starts = [0, *accumulate(map(len, parts))]
        views = [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part), "target": VERTICES}
            for start, part in zip(starts, parts, strict=False)
        ]
    accessors: list[dict[str, Any]] = [
        {"componentType": KINDS_OF[column.dtype], "count": len(column)}
        | {"type": GLB_KINDS[column.shape[1]]}
        | ({} if spz else {"bufferView": index})
        for index, column in enumerate(columns.values())
    ]
    means = columns["POSITION"]
    accessors[0] |= {"min": means.amin(dim=0).tolist(), "max": means.amax(dim=0).tolist()}
    accessors[1]["normalized"] = True
    splatting: dict[str, Any] = {
        "kernel": "ellipse",
        "colorSpace": DISPLAYED,
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "attributes": {name: index for index, name in enumerate(columns)},
        "mode": GLTF_POINTS,
        "extensions": {SPLATTING: splatting},
    }
    if spz:
        splatting["extensions"] = {SPZ[0]: {"bufferView": 0}}
    names = [SPLATTING, SPZ[0]] if spz else [SPLATTING]
    document = {
        "asset": {
            "version": f"{GLB_VERSION}.0",
            "generator": "StyleSplat",
            "extras": {SPLATTING: GLTF_DRAFT},
        },
        "extensionsUsed": names,
        **({"extensionsRequired": names} if spz else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **half_turned_node(splats.world_offset, as_matrix=spz)}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": sum(map(len, parts))}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return document, parts

"""Splats in glTF 2.0 files (`.glb`, `.gltf`) with Khronos' KHR_gaussian_splatting.

The extension (https://github.com/KhronosGroup/glTF, extensions/2.0/Khronos) has standard deviations
and opacities where PLY has logarithms and logits; its harmonics are the INRIA code's. Programs that
do not know it show a cloud of coloured points.
"""

import base64
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Shaped
from scipy.spatial.transform import Rotation
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.atomic import atomic_path
from stylesplat.io.splats.gltf_file import (
    BINARY,
    CHUNK,
    DISPLAYED,
    HEADER,
    JSON,
    MAGIC,
    SPLATTING,
    SPZ,
    VERSION,
    WIDTHS,
    Gltf,
    Node,
    Primitive,
    Splatting,
    attribute,
    harmonic,
    higher_bands,
    open_gltf,
)
from stylesplat.io.splats.packing import unit_quats
from stylesplat.io.splats.splat_ply import REMEDY, check_splats, of_degree, splat_fault
from stylesplat.io.splats.spz import LARGEST_RATIO, spz_within
from stylesplat.progress import say
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.splats import SH_C0, Splats

SMALLEST_ROW = 12  # bytes of a Gaussian whose attributes all share three numbers
SMALLEST = torch.finfo(torch.float32).tiny  # a standard deviation of 0 has no logarithm
POINTS = 0  # the mode of a primitive that is drawn as points
BANDS = (0, 3, 8, 15)  # higher bands up to each degree
# glTF's x left, y up, z forward to our (COLMAP's) x right, y down, z forward, and back
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
HALF_TURN_XYZW = [0.0, 0.0, 1.0, 0.0]
TOLERANCE = 1e-3  # of a rotation times its transpose; files round to about six digits
EXACT_WITHIN = 1e-6  # of quarter turns and of scale 1, which are then taken as exact
APPLY = "Apply the transforms of its nodes where you made it, and export it again."
FLOAT, SHORT = 5126, 5123
SIZES = {FLOAT: 4, SHORT: 2}  # bytes
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
        part = check_splats(_splats(gltf, primitive), path)
        parts.append(part if frame is None else check_splats(move_splats(part, frame), path))
        count += len(part)
        splatting = primitive.extensions.splatting
        packed = splatting is not None and any(name in splatting.extensions for name in SPZ)
        if count * SMALLEST_ROW > gltf.size * (LARGEST_RATIO if packed else 1):
            fault = f"it shows {count} Gaussians, which {gltf.size} bytes cannot hold"
            raise gltf.refusal(fault, "Export it without instances.")
    if len(parts) == 1:
        return parts[0]
    degree = max(part.sh_degree for part in parts)
    columns = zip(*(of_degree(part, degree).tensors().values() for part in parts), strict=True)
    means, quats, scales, opacities, sh0, shN = map(torch.cat, columns)
    return Splats(means, quats, scales, opacities, sh0, shN)


def _splats(gltf: Gltf, primitive: Primitive) -> Splats:
    """The splats of a primitive, in its own frame."""
    assert primitive.extensions.splatting is not None
    splatting = primitive.extensions.splatting
    _check_kind(gltf, primitive, splatting)
    packed = [splatting.extensions[name] for name in SPZ if name in splatting.extensions]
    if packed:
        return _unpack_spz(gltf, primitive, packed[0])
    degree = _degree(gltf, primitive)
    means = _column(gltf, primitive, "POSITION", 3)
    quats = _column(gltf, primitive, attribute("ROTATION"), 4)
    scales = _column(gltf, primitive, attribute("SCALE"), 3)
    if (scales < 0).any():
        raise gltf.refusal(f"{int((scales < 0).sum())} standard deviations are negative")
    shN = torch.empty(len(means), BANDS[degree], 3)
    for band, name in enumerate(higher_bands(degree)):
        shN[:, band] = _column(gltf, primitive, name, 3)
    return Splats(
        means=means,
        quats=quats[:, [3, 0, 1, 2]],
        scales=scales.clamp_(min=SMALLEST).log_(),
        opacities=_opacities(gltf, primitive),
        sh0=_column(gltf, primitive, harmonic(0, 0), 3)[:, None],
        shN=shN,
    )


def _unpack_spz(gltf: Gltf, primitive: Primitive, packed: Any) -> Splats:
    """The splats of a primitive as SPZ, in the axes of the primitive, unlike those of a `.spz`."""
    view = packed.get("bufferView") if isinstance(packed, dict) else None
    if type(view) is not int or view < 0:
        raise gltf.refusal("its SPZ names no bufferView")
    splats = spz_within(bytes(gltf.view_bytes(view, "SPZ")), gltf.path)
    positions = primitive.attributes.get("POSITION")
    expected = len(splats) if positions is None else gltf.accessor(positions, "POSITION").count
    if len(splats) != expected:
        fault = f"its splats have {expected} positions, but {len(splats)} rows of SPZ"
        raise gltf.refusal(fault)
    return splats


def _opacities(gltf: Gltf, primitive: Primitive) -> Float[Tensor, " N"]:
    """Logits; opacities of 0 and 1, which have none, become half a step more or less."""
    name = attribute("OPACITY")
    values = _column(gltf, primitive, name, 1)[:, 0]
    outside = int(((values < 0) | (values > 1)).sum())
    if outside:
        raise gltf.refusal(f"{outside} opacities are not between 0 and 1")
    step = gltf.step(primitive.attributes[name], name)
    low = SMALLEST if step < 1e-6 else step / 2  # float32 is fine near 0, and coarse near 1
    return values.double().clamp(low, 1 - step / 2).logit().float()


def _column(gltf: Gltf, primitive: Primitive, name: str, width: int) -> Float[Tensor, "N D"]:
    """The rows of an attribute, as many as there are positions."""
    if name not in primitive.attributes:
        raise gltf.refusal(f"its splats have no {name}")
    index, positions = primitive.attributes[name], primitive.attributes.get("POSITION", 0)
    count = gltf.accessor(index, name).count
    expected = gltf.accessor(positions, "POSITION").count
    if count != expected:
        raise gltf.refusal(f"its splats have {expected} positions, but {count} rows of {name}")
    return torch.from_numpy(gltf.rows(index, name, width))


def _check_kind(gltf: Gltf, primitive: Primitive, splatting: Splatting) -> None:
    """Refuse splats that are stored or drawn in another way."""
    unread = [name for name in splatting.extensions if "compression" in name and name not in SPZ]
    if unread:
        fault = f"its splats are compressed ({unread[0]:.60}), which is not read here"
        raise gltf.refusal(fault, "Export it without compression, or as .ply or .spz.")
    if splatting.kernel != "ellipse":
        fault = f"its splats are no ellipses, but {brief(splatting.kernel)!r}"
        raise gltf.refusal(fault, "Export it as .ply.")
    if primitive.mode != POINTS:
        raise gltf.refusal(f"its splats are no points, but of mode {primitive.mode}")
    if splatting.color_space != DISPLAYED:
        say(
            f"{gltf.path} has its colours in {brief(splatting.color_space)!r}: they are read as "
            f"{DISPLAYED}, so they may look darker."
        )


def _degree(gltf: Gltf, primitive: Primitive) -> int:
    """The degree of the harmonics: each degree must be complete, with all below it."""
    there = [name for name in primitive.attributes if name.startswith(attribute("SH_DEGREE_"))]
    for degree in reversed(range(len(BANDS))):
        wanted = {harmonic(0, 0), *higher_bands(degree)}
        if wanted <= {*there}:
            break
    else:
        raise gltf.refusal(f"its splats have no {harmonic(0, 0)}")
    left = [name for name in there if name not in wanted]
    if any(int(part) < len(BANDS) for name in left if (part := name.split("_")[4]).isdigit()):
        raise gltf.refusal(f"its splats have {brief(left[0])}, but not all of its degree and below")
    if left:
        say(f"{gltf.path} has colours of a higher degree than 3: left out.")
    return degree


def _placed_splats(gltf: Gltf) -> Iterator[tuple[Primitive, Frame | None]]:
    """The splats of the scene and the transform of each to our world; None leaves them as they are.

    If no node of the scene shows splats, all splats of the file count, without a transform.
    """
    shown = [*_shown(gltf)] or [
        (each, np.eye(4))
        for mesh in range(len(gltf.document.meshes))
        for each in _primitives(gltf, mesh)
    ]
    if not shown:
        names = gltf.document.extensions_used
        other = next((name for name in names if "splat" in name and name != SPLATTING), None)
        if other is not None:
            fault = f"its splats are stored by {other:.60}, which is not read here"
            raise gltf.refusal(fault, f"Export it with {SPLATTING} alone, or as .ply or .spz.")
        fault = f"it holds no splats, but an ordinary model (nothing in it has {SPLATTING})"
        raise gltf.refusal(fault, "Give a file of Gaussian splats.")
    for primitive, matrix in shown:
        yield primitive, _frame(gltf, matrix)


def _shown(gltf: Gltf) -> Iterator[tuple[Primitive, Float[np.ndarray, "4 4"]]]:
    """The splats that the scene shows, with their transforms to glTF's world."""
    document, visited = gltf.document, set[int]()
    if document.scenes:
        roots = document.scenes[min(document.scene, len(document.scenes) - 1)].nodes
    else:
        children = {child for node in document.nodes for child in node.children}
        roots = [index for index in range(len(document.nodes)) if index not in children]
    stack = [(root, np.eye(4)) for root in reversed(roots)]
    while stack:
        index, above = stack.pop()
        if index in visited or index >= len(document.nodes):
            raise gltf.refusal(f"its nodes are no tree (at node {index} of {len(document.nodes)})")
        visited.add(index)
        node = document.nodes[index]
        matrix = above @ _matrix(gltf, node)
        if node.mesh is not None:
            yield from ((each, matrix) for each in _primitives(gltf, node.mesh))
        stack += [(child, matrix) for child in reversed(node.children)]


def _primitives(gltf: Gltf, mesh: int) -> list[Primitive]:
    meshes = gltf.document.meshes
    if mesh >= len(meshes):
        raise gltf.refusal(f"a node shows mesh {mesh} of {len(meshes)}")
    return [each for each in meshes[mesh].primitives if each.extensions.splatting is not None]


def _matrix(gltf: Gltf, node: Node) -> Float[np.ndarray, "4 4"]:
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T  # column-major
    matrix = np.eye(4)
    if not 1e-100 < float(np.abs(node.rotation).max()) < 1e100:  # float64 holds the squares
        raise gltf.refusal("a node's rotation is none", APPLY)
    matrix[:3, :3] = Rotation.from_quat(node.rotation).as_matrix() * node.scale
    matrix[:3, 3] = node.translation
    return matrix


def _frame(gltf: Gltf, matrix: Float[np.ndarray, "4 4"]) -> Frame | None:
    """A transform to glTF's world as one to ours; None for the identity."""
    with np.errstate(all="ignore"):  # an overflow is refused below
        linear = matrix[:3, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        rotation = linear / scale
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (scale > 0 and error < TOLERANCE and np.isfinite(matrix).all()):
        raise gltf.refusal("a node mirrors, shears or stretches its splats", APPLY)
    u, _, vt = np.linalg.svd(HALF_TURN @ rotation)
    rotation, shift = u @ vt, HALF_TURN @ matrix[:3, 3]
    if np.abs(rotation - rotation.round()).max() < EXACT_WITHIN:
        rotation = rotation.round() + 0.0  # no -0
    scale = 1.0 if abs(scale - 1) < EXACT_WITHIN else scale
    if scale == 1 and (rotation == np.eye(3)).all() and not shift.any():
        return None
    return Frame(torch.from_numpy(rotation), scale, torch.from_numpy(shift))


class _Column(NamedTuple):
    """An attribute, whose values are computed when they are written."""

    name: str
    kind: str
    component: int
    values: Callable[[], Tensor]


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
    content = base64.b64encode(b"".join(_bytes(columns))).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{content}"
    with atomic_path(path) as draft:
        draft.write_text(json.dumps(document, indent=1))


def _parts(splats: Splats, path: Path) -> tuple[list[_Column], dict[str, Any]]:
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


def _bytes(columns: list[_Column]) -> Iterator[memoryview]:
    for column in columns:
        yield np.ascontiguousarray(column.values().numpy()).data.cast("B")


def _columns(splats: Splats) -> list[_Column]:
    """The attributes in their order; each size is a multiple of four, as the format demands."""
    colors = [splats.sh0[:, 0], *splats.shN.unbind(dim=1)]
    names = [harmonic(0, 0), *higher_bands(splats.sh_degree)]
    return [
        _Column("POSITION", "VEC3", FLOAT, lambda: splats.means),
        _Column("COLOR_0", "VEC4", SHORT, lambda: _fallback(splats)),
        _Column(
            attribute("ROTATION"), "VEC4", FLOAT, lambda: unit_quats(splats.quats)[:, [1, 2, 3, 0]]
        ),
        _Column(
            attribute("SCALE"), "VEC3", FLOAT, lambda: splats.scales.exp().clamp_(min=SMALLEST)
        ),
        _Column(attribute("OPACITY"), "SCALAR", FLOAT, splats.opacities.sigmoid),
        *(
            _Column(name, "VEC3", FLOAT, lambda color=color: color)
            for name, color in zip(names, colors, strict=True)
        ),
    ]


def _fallback(splats: Splats) -> Shaped[Tensor, "N 4"]:
    """Linear colours and alpha for programs that draw points."""
    shown = (SH_C0 * splats.sh0[:, 0] + 0.5).clamp_(0, 1)
    linear = torch.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)  # sRGB
    rgba = torch.cat([linear, splats.opacities.sigmoid()[:, None]], dim=1)
    return (rgba * 65535).round_().to(torch.uint16)


def _document(columns: list[_Column], splats: Splats) -> dict[str, Any]:
    views, accessors, offset = [], [], 0
    for index, column in enumerate(columns):
        size = len(splats) * WIDTHS[column.kind] * SIZES[column.component]
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
        "asset": {"version": f"{VERSION}.0", "generator": "StyleSplat"},
        "extensionsUsed": [SPLATTING],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": HALF_TURN_XYZW}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }

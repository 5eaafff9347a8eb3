"""Which splats a glTF file shows, and where: its nodes' transforms, in our axes."""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from stylesplat.io.splats.gltf_document import SPLATTING, Gltf, Node, Primitive
from stylesplat.scene.frames import Frame

# glTF's x left, y up, z forward and our (COLMAP's) x right, y down, z forward, either way
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
HALF_TURN_XYZW = [0.0, 0.0, 1.0, 0.0]
TOLERANCE = 1e-3  # of a turn times its transpose; files round to six digits or so
WHOLE = 1e-6  # what is within this of a turn by quarters, or of the scale 1, is one
SPLIT = "Apply the transforms of its nodes where you made it, and export it again."


def placed_splats(gltf: Gltf) -> Iterator[tuple[Primitive, Frame | None]]:
    """The splats of the scene, and how they come from their own frame to ours; None is as they are.

    Splats that no node of the scene shows count as if one without a transform did, if no others
    are there.

    Raises:
        StyleSplatError: If there are none, or a transform is more than a turn, a shift and a scale.
    """
    shown = [*_shown(gltf)] or [
        (each, np.eye(4)) for mesh in range(len(gltf.document.meshes)) for each in _of(gltf, mesh)
    ]
    if not shown:
        raise _none(gltf)
    for primitive, matrix in shown:
        yield primitive, _frame(gltf, matrix)


def _none(gltf: Gltf) -> Exception:
    names = gltf.document.extensions_used
    other = next((n for n in names if "splat" in n and n != SPLATTING), None)
    if other is not None:
        fault = f"its splats are stored by {other:.60}, which is not read here"
        return gltf.refusal(fault, f"Export it with {SPLATTING} alone, or as .ply or .spz.")
    fault = f"it holds no splats, but an ordinary model (nothing in it has {SPLATTING})"
    return gltf.refusal(fault, "Give a file of Gaussian splats.")


def _shown(gltf: Gltf) -> Iterator[tuple[Primitive, Float[np.ndarray, "4 4"]]]:
    """The splats that the first scene shows, with their transforms to glTF's world."""
    nodes, seen = gltf.document.nodes, set[int]()
    below = [(root, np.eye(4)) for root in reversed(_roots(gltf))]
    while below:
        index, above = below.pop()
        if index in seen or index >= len(nodes):
            raise gltf.refusal(f"its nodes are no tree (at node {index} of {len(nodes)})")
        seen.add(index)
        node = nodes[index]
        matrix = above @ _matrix(gltf, node)
        if node.mesh is not None:
            yield from ((each, matrix) for each in _of(gltf, node.mesh))
        below += [(child, matrix) for child in reversed(node.children)]


def _roots(gltf: Gltf) -> list[int]:
    document = gltf.document
    if document.scenes:
        return document.scenes[min(document.scene, len(document.scenes) - 1)].nodes
    children = {child for node in document.nodes for child in node.children}
    return [index for index in range(len(document.nodes)) if index not in children]


def _of(gltf: Gltf, mesh: int) -> list[Primitive]:
    """The splats of a mesh."""
    meshes = gltf.document.meshes
    if mesh >= len(meshes):
        raise gltf.refusal(f"a node shows mesh {mesh} of {len(meshes)}")
    return [each for each in meshes[mesh].primitives if each.extensions.splatting is not None]


def _matrix(gltf: Gltf, node: Node) -> Float[np.ndarray, "4 4"]:
    """The transform of a node to its parent."""
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T  # columns follow each other
    matrix = np.eye(4)
    if not 1e-100 < float(np.abs(node.rotation).max()) < 1e100:  # squares are of float64
        raise gltf.refusal("a node's rotation is none", SPLIT)
    matrix[:3, :3] = Rotation.from_quat(node.rotation).as_matrix() * node.scale
    matrix[:3, 3] = node.translation
    return matrix


def _frame(gltf: Gltf, matrix: Float[np.ndarray, "4 4"]) -> Frame | None:
    """A transform to glTF's world as one to ours."""
    with np.errstate(all="ignore"):  # what overflows is refused
        linear = matrix[:3, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        turn = linear / scale
        error = np.abs(turn @ turn.T - np.eye(3)).max()
    if not (scale > 0 and error < TOLERANCE and np.isfinite(matrix).all()):
        raise gltf.refusal("a node mirrors, shears or stretches its splats", SPLIT)
    u, _, vt = np.linalg.svd(HALF_TURN @ turn)
    turn, shift = u @ vt, HALF_TURN @ matrix[:3, 3]
    if np.abs(turn - turn.round()).max() < WHOLE:
        turn = turn.round() + 0.0  # no -0
    scale = 1.0 if abs(scale - 1) < WHOLE else scale
    if scale == 1 and (turn == np.eye(3)).all() and not shift.any():
        return None
    return Frame(torch.from_numpy(turn), scale, torch.from_numpy(shift))

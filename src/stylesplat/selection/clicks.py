"""Objects of a splat without labels, by clicks: the graph of its surface, cut around the clicks.

Random walks over the graph start at a click and end on large planes, or with a small probability
at each step. They visit the clicked object first: the patches, ordered by visits, are cut where
the boundary is weakest for the size of what it encloses (Andersen, Chung, Lang: Local graph
partitioning using PageRank vectors, FOCS 2006; Grady: Random walks for image segmentation, PAMI
2006). What is enclosed is cut once more where two objects touch. Parts are found in the same way
in a graph whose connections follow colours, planes included.
"""

from collections.abc import Iterable

import numpy as np
import torch
from jaxtyping import Bool, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.shares import AT_ONCE, COVERED, contributed, without_looks
from stylesplat.scene.arguments import PickSize, check_point
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.selection.figure_ground import occluding_share
from stylesplat.selection.random_walks import nearer_to_seeds, sweep, two_sided
from stylesplat.selection.surface_graph import (
    NothingToPick,
    SurfaceGraph,
    surface_of,
    symmetric,
)

FOLD = 8.0  # how fast connections weaken across folds
NEAREST = 40_000  # patches around the clicks; farther ones are background
# Cut connections over the root of the smaller side's, below which two objects touch: 0.1 on the
# demo, where the weakest cuts through single objects have 1.3 and more, and 2.4 through the fox.
WEAK = 1.0
# The same cost, below which a piece of a surface is bounded all around: the fox's plaque has 0.09
# to 0.17 from seven clicks, smaller pieces of it 0.29 and more.
BOUNDED = 0.2
FEW = 20  # patches that a piece has at least
MIN_OCCLUDING = 0.02  # of `occluding_share`, below which a pick is background


def pick_clicked(
    splats: Splats,
    cameras: Cameras,
    points: Iterable[tuple[str, tuple[float, float]]],
    not_points: Iterable[tuple[str, tuple[float, float]]] = (),
    size: PickSize = "object",
) -> Bool[Tensor, " N"]:
    """The Gaussians of the clicked objects of a splat; labels are not needed.

    Args:
        splats: The splat.
        cameras: Views of it.
        points: Views and pixels of the objects.
        not_points: The same for what touches them and does not belong to them.
        size: `group` is everything that touches, `object` ends at folds, and `part` is a piece of
            a surface, large planes included, that is bounded by folds or changes of colour.

    Raises:
        StyleSplatError: If a point shows nothing or background, or is excluded again.
    """
    device = splats.device
    if device.type != "cpu":
        splats = splats.to("cpu")
    surface, places = surface_of(splats, cameras), [*points]
    clicked, others = (
        np.unique([_patch_at(surface, splats, cameras, *each, size) for each in some]).astype(int)
        for some in (places, not_points)
    )
    graph = surface.pieces() if size == "part" else surface.connections(FOLD)
    chosen = np.zeros(len(surface.points), bool)
    parts = _parts(surface, size)
    for part in np.unique(parts[clicked]):
        rows = _nearest(surface, np.flatnonzero(parts == part), clicked)
        seeds, rivals = (each[parts[each] == part] for each in (clicked, others))
        if len(np.intersect1d(seeds, rivals)):
            raise StyleSplatError("A point and a point to exclude hit the same place. Move one.")
        chosen[_cut(graph, rows, seeds, rivals, size)] = True
    picked = torch.from_numpy(chosen[surface.owners])
    if size != "part" and occluding_share(splats, cameras, picked) < MIN_OCCLUDING:
        raise _background_error(*places[0])
    return picked.to(device)


def _parts(surface: SurfaceGraph, size: PickSize) -> Int[np.ndarray, " K"]:
    """The number of the connected part of each patch, without background but for pieces."""
    solid = surface.touching
    if size != "part":
        solid = solid[~surface.is_background[solid].any(axis=1)]
    count = len(surface.points)
    return connected_components(symmetric(np.ones(len(solid)), solid, count), directed=False)[1]


def _cut(
    graph: csr_array, rows: np.ndarray, seeds: np.ndarray, rivals: np.ndarray, size: PickSize
) -> np.ndarray:
    """The patches of the seeds among connected ones, without those of the rivals."""
    if len(rivals):
        rows = nearer_to_seeds(graph, rows, seeds, rivals, graph.sum(axis=1)[rows])
    if size == "part":
        return _piece(graph, rows, seeds)
    if size == "object":
        return two_sided(graph, _enclosed(graph, rows, seeds), seeds, WEAK)
    return rows


def _piece(graph: csr_array, rows: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """The smallest set of patches around the seeds that is well bounded."""
    order, boundary, sums = sweep(graph, rows, seeds, graph.sum(axis=1)[rows])
    cost = boundary / np.sqrt(np.minimum(sums, sums[-1] - sums).clip(1e-12))
    cost[: min(max(FEW, len(seeds)), len(rows)) - 1] = np.inf
    bounded = cost < BOUNDED
    if bounded.any():
        first = int(bounded.argmax())
        length = int((~bounded[first:]).argmax()) or len(rows)
        best = first + int(cost[first : first + length].argmin())
    else:
        best = int(cost.argmin())
    return rows[order[: best + 1]]


def _nearest(surface: SurfaceGraph, rows: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """The patches closest to seeds, in which walks are found within a second."""
    if len(rows) <= NEAREST:
        return rows
    away = KDTree(surface.points[seeds]).query(surface.points[rows])[0]
    return np.sort(rows[np.argpartition(away, NEAREST)[:NEAREST]])


def _enclosed(graph: csr_array, rows: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """The patches around the seeds of which the smallest share of connections leads out."""
    order, boundary, sums = sweep(graph, rows, seeds, graph.sum(axis=1)[rows])
    least = len(seeds) - 1
    return rows[order[: least + 1 + int((boundary / sums)[least:].argmin())]]


def _patch_at(
    surface: SurfaceGraph,
    splats: Splats,
    cameras: Cameras,
    view: str,
    point: tuple[float, float],
    size: PickSize,
) -> int:
    """The patch that shows most at a pixel."""
    camera = cameras[cameras.index(view)]
    check_point(point, camera.size, view)
    pixel = crop(camera, (int(point[0]), int(point[1])), (1, 1))
    shown = contributed(without_looks(splats), pixel, torch.ones(1, 1, AT_ONCE))[:, 0].numpy()
    if shown.sum() < COVERED:
        raise NothingToPick(
            f"Nothing solid shows at {point[0]:g},{point[1]:g} in {view}. Choose another pixel."
        )
    best = int(np.bincount(surface.owners, shown).argmax())
    if size != "part" and surface.is_background[best]:
        raise _background_error(view, point)
    return best


def _background_error(view: str, point: tuple[float, float]) -> NothingToPick:
    return NothingToPick(
        f"Background shows at {point[0]:g},{point[1]:g} in {view}: a large plane, or what has "
        "nothing behind it. Point at an object, take what is flat on a plane with --size part, or "
        "pick by shape with --sphere or --box3d."
    )

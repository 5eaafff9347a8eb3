"""Objects of a splat without labels, cut out of the graph of its surface, by clicks or by masks.

Random walks over the graph start at a click and end on large planes, or with a small probability
at each step. They visit the clicked object first: of the patches, ordered by visits, the object is
the largest set whose outline is hardly open (Andersen, Chung, Lang: Local graph partitioning using
PageRank vectors, FOCS 2006; Grady: Random walks for image segmentation, PAMI 2006). It is cut once
more where two objects touch. Parts are found in the same way in a graph whose connections follow
colours, planes included.

Masks of a few views are completed on the graph of pieces: what they do not tell about goes with
the side, the object or what is outside, from which walks come to it more often.

An outline is open, too, where it leaves the photos: then walks end at their margins.

A pick that does not stand before something is background. What is behind an object shows along its
outline: there the depth jumps. A piece of a wall ends where something nearer hides it, or nowhere.
"""

from collections.abc import Iterable
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.options import PickSize, check_point
from stylesplat.rendering.weights import COVERED, TINY_COVERAGE, composite, pixels_in
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Mask
from stylesplat.scene.projection import depths_of
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.selection.shapes import robust_diameter
from stylesplat.selection.shares import small_views
from stylesplat.selection.surface_graph import (
    GRAPH_TOUCH,
    NothingToPick,
    SurfaceGraph,
    surface_of,
    symmetric,
)

# Half and twice each was tried by clicks on demo, toy, fox and cape: IoU moves by .006 at most
ENDS = 1e-5  # probability with which a walk ends at a step
CUT_SMALLEST = 0.02  # share of the connections that the smaller side of a cut has


def two_sided(graph: csr_array, rows: np.ndarray, seeds: np.ndarray, limit: float) -> np.ndarray:
    """The rows on the seeds' side of the weakest cut through some; all if none is weak."""
    order, boundary, sums = sweep(graph, rows, seeds, graph[rows][:, rows].sum(axis=1))
    smaller = np.minimum(sums, sums[-1] - sums)
    cost = boundary / np.sqrt(smaller.clip(1e-12))
    cost[(smaller < CUT_SMALLEST * sums[-1]) | (np.arange(len(rows)) < len(seeds) - 1)] = np.inf
    best = int(cost.argmin())
    return rows[order[: best + 1]] if cost[best] < limit else rows


def sweep(
    graph: csr_array, rows: np.ndarray, seeds: np.ndarray, sums: Float[np.ndarray, " R"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows ordered by visits, and for each the connections that it and those before have.

    Args:
        graph: Connections of all nodes.
        rows: The nodes to order.
        seeds: Those that walks start at.
        sums: The sum of the connections of each; walks end that take those to other nodes.

    Returns:
        The order, the connections that lead out, and all.
    """
    inside, seeded = graph[rows][:, rows], np.isin(rows, seeds)
    order = np.argsort(-visits(inside, seeded, sums) - seeded * 1e9, kind="stable")
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    pairs = inside.tocoo()
    inner = np.bincount(np.maximum(*(ranks[each] for each in pairs.coords)), pairs.data, len(rows))
    total = sums[order].cumsum()
    return order, total - inner.cumsum(), total


def nearer_to_seeds(
    graph: csr_array,
    rows: np.ndarray,
    seeds: np.ndarray,
    rivals: np.ndarray,
    sums: Float[np.ndarray, " R"],
) -> np.ndarray:
    """The rows that walks from the seeds visit more than those from the rivals; as in `sweep`."""
    inside = graph[rows][:, rows]
    mine, theirs = (visits(inside, np.isin(rows, each), sums) for each in (seeds, rivals))
    return rows[(mine > theirs) | np.isin(rows, seeds)]


def visits(
    graph: csr_array, seeded: Bool[np.ndarray, " R"], sums: Float[np.ndarray, " R"]
) -> Float[np.ndarray, " R"]:
    """Visits of walks from the seeds to each node, over the sum of its connections."""
    sums = sums.clip(1e-12)
    starts = seeded * sums / max((seeded * sums).sum(), 1e-12)
    return solve_symmetric(csr_array(diags_array(sums * (1 + ENDS)) - graph), starts)


def solve_symmetric(system: csr_array, right: Float[np.ndarray, " R"]) -> Float[np.ndarray, " R"]:
    """The solution of a sparse system that is symmetric and diagonally dominant."""
    options = {"SymmetricMode": True}
    factors = splu(system.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return factors.solve(right)


# Half and twice each: no click on demo, toy, fox and cape is refused, or taken, that was not
CUT_VIEWS = 6  # in which outlines are looked at
WIDTH = 2  # pixels on either side of an outline
FARTHER = 0.04  # of the pick's extent, by which depths at an outline jump


@torch.no_grad()
def occluding_share(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> float:
    """The share of a pick's outlines in a few views that something farther, or nothing, is beside.

    On the fox, the picture on its wall and the demo's objects .08 to .89, on pieces of walls and of
    the demo's curved backdrop .00; 1 for what fills all views, 0 for what no view shows.
    """
    farther, whole, shown = 0, 0, 0
    jump = 0.0
    if picked.any():  # a surface is known to the size of its Gaussians
        size = float(splats.scales[picked].exp().amax(dim=1).median())
        jump = size + FARTHER * robust_diameter(splats.means[picked])
    for camera in evenly_spaced(small_views(cameras), CUT_VIEWS):
        depths = depths_of(splats.means, camera)
        values = torch.stack([depths, picked.to(depths), torch.ones_like(depths)], dim=1)
        summed, own_alphas, alphas = composite(splats, camera, values).unbind(dim=-1)
        depths = (summed / alphas.clamp(min=TINY_COVERAGE)).numpy()
        inside = (own_alphas > COVERED).numpy()
        beside = maximum_filter(inside, 2 * WIDTH + 1) & ~inside
        own = maximum_filter(np.where(inside, depths, 0).astype(np.float32), 2 * WIDTH + 1)
        empty = (alphas < COVERED).numpy()
        farther += int((beside & ((depths > own + jump) | empty)).sum())
        whole += int(beside.sum())
        shown += int(inside.sum())
    return farther / whole if whole else float(shown > 0)


MASK_SEEN = 1.0  # pixels in the masks' views, from which masks tell about a patch
MASK_INSIDE, MASK_OUTSIDE = 0.9, 0.5  # shares of a patch's pixels that make it the object's, or not
# Of the seeds in the part that has most: a part with fewer is no part of the object
MASK_STRAY = 0.2


def pick_masked(
    splats: Splats,
    cameras: Cameras,
    masks: Iterable[tuple[int, Mask, Mask]],
) -> Bool[Tensor, " N"]:
    """The Gaussians of the object that some masks show, without the surface that it stands on.

    Patches that the masks do not tell about are the object's if walks along pieces of one colour
    come to them from it rather than from what is outside.

    Args:
        splats: The splat, on the CPU.
        cameras: Views of it.
        masks: Rows of views, the pixels that show the object, and pixels that do not.

    Returns:
        The picked Gaussians; none if the masks show none but those of large planes.
    """
    surface = surface_of(splats, cameras)
    rows, insides, outsides = zip(*masks, strict=True)
    everywhere = map(torch.ones_like, insides)
    shown = map(partial(torch.stack, dim=-1), zip(insides, outsides, everywhere, strict=True))
    pixels = pixels_in(splats, cameras[rows], shown).double().numpy()
    seen = np.zeros((len(surface.points), 3))
    np.add.at(seen, surface.owners, pixels)
    inside, outside, everywhere = seen.T
    told = (everywhere > MASK_SEEN) & ~surface.is_background
    own = np.flatnonzero(told & (inside > MASK_INSIDE * everywhere))
    others = np.flatnonzero(told & (outside > MASK_OUTSIDE * everywhere))
    graph, parts = surface.pieces(), _parts(surface, "object")
    counts = np.bincount(parts[own], minlength=1)
    chosen = np.zeros(len(surface.points), bool)
    for part in np.flatnonzero(counts > MASK_STRAY * counts.max()):
        seeds, rivals = (each[parts[each] == part] for each in (own, others))
        rows = _nearest(surface, np.flatnonzero(parts == part), seeds)
        if len(rivals):
            sums = graph[rows][:, rows].sum(axis=1)
            rows = nearer_to_seeds(graph, rows, seeds, rivals, sums)
        chosen[rows] = True
    return torch.from_numpy(chosen[surface.owners])


# How fast connections weaken across folds (`SurfaceGraph.connections`): where an object ends, and
# where two touch. Half and twice of the first move the IoU of clicks on demo, toy and cape by .0001
# in the mean; with twice the second the toy falls from .93 to .53.
CUT_FOLD, SOFT_FOLD = 8.0, 2.0
CUT_NEAREST = 40_000  # patches around the clicks; farther ones are background
# Of the outline of a disc of its area, below which an object's is closed: a toy's is open by .2
# where it stands, and by .04 at its neck, a bottle's by .3, a fox's on its plaque by .4. With .3
# the fox and the bottle are the same, and a mouse takes its desk. The same for the part of an
# outline where the photos end: of toy, cape, fox, bottle and mouse it is .0 to .3, of a bed with a
# doll, and of a desk with its wall, 1.2 to 3.5.
CLICK_OPEN = 0.5
# Cut connections over the root of the smaller side's, below which two objects touch: those of the
# demo have .2, a toy's neck .5, its single objects 2.9. Sharper folds divide the neck, too. Half of
# it costs the demo's clicks .19 in the mean, twice the toy's .40.
CONTACT = 0.4
# Pairs of patches that touch across the outline of a disc on a flat surface, over the root of the
# number of its patches; 2/3 GRAPH_TOUCH^3 cross a straight line in an edge of a patch
DISC_OUTLINE = 2 * np.pi**0.5 * 2 / 3 * GRAPH_TOUCH**3
# The same cost, below which a piece of a surface is bounded all around: the fox's plaque has 0.09
# to 0.17 from seven clicks, smaller pieces of it 0.29 and more.
BOUNDED = 0.2
CUT_FEW = 20  # patches that an object or a piece has at least
MIN_OCCLUDING = 0.02  # of `occluding_share`, below which a pick is background


Click = tuple[Cameras, tuple[float, float]]
"""A single camera and a pixel of it."""


def pick_clicked(
    splats: Splats,
    cameras: Cameras,
    points: Iterable[Click],
    not_points: Iterable[Click] = (),
    size: PickSize = "object",
) -> Bool[Tensor, " N"]:
    """The Gaussians of the clicked objects of a splat; labels are not needed.

    Args:
        splats: The splat.
        cameras: Views of it.
        points: Single cameras, which need not be of the views, and pixels of the objects.
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
        np.unique([_patch_at(surface, splats, *each, size) for each in some]).astype(int)
        for some in (places, not_points)
    )
    chosen = np.zeros(len(surface.points), bool)
    parts = _parts(surface, size)
    for part in np.unique(parts[clicked]):
        rows = _nearest(surface, np.flatnonzero(parts == part), clicked)
        seeds, rivals = (each[parts[each] == part] for each in (clicked, others))
        if len(np.intersect1d(seeds, rivals)):
            raise StyleSplatError("A point and a point to exclude hit the same place. Move one.")
        chosen[_cut_click(surface, rows, seeds, rivals, size)] = True
    picked = torch.from_numpy(chosen[surface.owners])
    if size != "part" and occluding_share(splats, cameras, picked) < MIN_OCCLUDING:
        camera, point = places[0]
        raise _background_error(camera.names[0], point)
    return picked.to(device)


def _parts(surface: SurfaceGraph, size: PickSize) -> Int[np.ndarray, " K"]:
    """The number of the connected part of each patch, without background but for pieces."""
    solid = surface.touching
    if size != "part":
        solid = solid[~surface.is_background[solid].any(axis=1)]
    count = len(surface.points)
    return connected_components(symmetric(np.ones(len(solid)), solid, count), directed=False)[1]


def _cut_click(
    surface: SurfaceGraph, rows: np.ndarray, seeds: np.ndarray, rivals: np.ndarray, size: PickSize
) -> np.ndarray:
    """The patches of the seeds among connected ones, without those of the rivals."""
    graph = surface.pieces() if size == "part" else surface.connections(CUT_FOLD)
    sums = graph.sum(axis=1)
    if len(rivals):
        rows = nearer_to_seeds(graph, rows, seeds, rivals, sums[rows])
    if size == "part":
        return _piece(graph, rows, seeds)
    if size == "group":
        return rows
    own = _enclosed(surface, graph, sums, rows, seeds)
    beyond = sums * surface.at_margin  # as many connections lead out of the photos as into them
    if beyond[own].sum() < CLICK_OPEN * DISC_OUTLINE * len(own) ** 0.5:
        return own
    return _enclosed(surface, graph, sums + beyond, rows, seeds)


def _piece(graph: csr_array, rows: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """The smallest set of patches around the seeds that is well bounded."""
    order, boundary, sums = sweep(graph, rows, seeds, graph.sum(axis=1)[rows])
    cost = boundary / np.sqrt(np.minimum(sums, sums[-1] - sums).clip(1e-12))
    cost[: min(max(CUT_FEW, len(seeds)), len(rows)) - 1] = np.inf
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
    if len(rows) <= CUT_NEAREST:
        return rows
    away = KDTree(surface.points[seeds]).query(surface.points[rows])[0]
    return np.sort(rows[np.argpartition(away, CUT_NEAREST)[:CUT_NEAREST]])


def _enclosed(
    surface: SurfaceGraph,
    graph: csr_array,
    sums: Float[np.ndarray, " K"],
    rows: np.ndarray,
    seeds: np.ndarray,
) -> np.ndarray:
    """The largest set of patches around the seeds whose outline is hardly open.

    An outline is open where the surface goes on across it without a fold. Where that holds for no
    set, it is the one of which the smallest share of connections leads out. It is cut once more
    where two objects touch.
    """
    order, boundary, totals = sweep(graph, rows, seeds, sums[rows])
    least = min(max(CUT_FEW, len(seeds)), len(rows)) - 1
    discs = DISC_OUTLINE * np.sqrt(np.arange(1, len(rows) + 1))
    closed = np.flatnonzero((boundary < CLICK_OPEN * discs)[least:])
    best = closed[-1] if len(closed) else (boundary / totals)[least:].argmin()
    own = rows[order[: least + 1 + int(best)]]
    return two_sided(surface.connections(SOFT_FOLD), own, seeds, CONTACT)


def _patch_at(
    surface: SurfaceGraph,
    splats: Splats,
    camera: Cameras,
    point: tuple[float, float],
    size: PickSize,
) -> int:
    """The patch that shows most at a pixel."""
    (view,) = camera.names
    check_point(point, camera.size, view)
    pixel = camera.crop((int(point[0]), int(point[1])), (1, 1))
    shown = pixels_in(splats, pixel, [torch.ones(1, 1)]).numpy()
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

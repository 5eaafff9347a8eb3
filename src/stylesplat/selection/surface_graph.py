"""The visible surface of a splat as a graph: small patches of equal size, and which ones touch.

Renders of depth in a few views give points of the surface, however unevenly the Gaussians lie. A
grid in space gathers the points into patches with a colour and a normal. Neighbouring patches are
connected, weakly across a concave fold, as where one object leans on another, and across a change
of colour. Large planes (a table, a wall) are background.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import lab_from_rgb
from stylesplat.progress import track
from stylesplat.rendering.render import render
from stylesplat.rendering.surface import average_in_voxels, depth_map, surface_points
from stylesplat.rendering.weights import geometry_only, pixels_in
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sequences import cached_while_alive
from stylesplat.scene.splats import Splats
from stylesplat.selection.shares import UNSEEN_PIXELS, small_views

# Edge of a patch in pixels of the sampled views, at the median distance. On the fox and the demo 4
# to 9 give the same objects.
PATCH = 5.0
GRAPH_GRAZING = 0.15  # cosine of the angle to the view's ray below which depth is noise
MIN_POINTS, MIN_PATCHES = 3, 8  # in a patch, and in connected patches; fewer are noise
GRAPH_TOUCH = 1.8  # edges of a patch between the middles of two that touch
# Half a plane's thickness: in medians of how far its patches lie from it; at most, in edges of a
# patch; at least, in parts of that
PLANE_SCATTER, PLANE_THICKEST, PLANE_THINNEST = 3.0, 1.2, 0.5
GRAPH_PLANE = 0.15  # share of what shows from which a plane is background; the demo's table has .35
# Share of the variance of normals that goes linearly with the place, from which a surface is
# curved: .02 to .06 on tables and walls of four captures, .65 on the side of a cape
PLANE_CURVED = 0.5
# Cosines of normals to a plane's that fit it, in candidates and planes
PLANE_UPRIGHT, PLANE_ALONG = 0.9, 0.8
PLANE_SAMPLE, PLANE_TRIES = 4000, 200  # points and candidates to find a plane
# Differences of colours (CIELAB) and normals that divide pieces of a surface, rounds of mean shift,
# and how fast their connections weaken
PIECE_SHADE, PIECE_BEND, PIECE_SHIFTS, PIECE_EDGES = 5.0, 0.7, 10, 6.0


class NothingToPick(StyleSplatError):
    """What was pointed at is no object: it is background, or nothing solid."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A large plane."""

    centre: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]
    thickness: float
    """Half of it, as far as its patches scatter."""

    def heights(self, points: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, " M"]:
        return (points - self.centre) @ self.normal


@dataclass(frozen=True, eq=False)
class SurfaceGraph:
    """The surface of a splat as a graph of K patches."""

    owners: Int[np.ndarray, " N"]
    """The patch that shows each Gaussian, or that is next to a hidden one."""
    points: Float[np.ndarray, "K 3"]
    colors: Float[np.ndarray, "K 3"]
    normals: Float[np.ndarray, "K 3"]
    touching: Int[np.ndarray, "P 2"]
    """Pairs of patches."""
    is_background: Bool[np.ndarray, " K"]
    """Large planes, and patches that touch hardly any other."""
    at_margin: Bool[np.ndarray, " K"]
    """Patches that photos show at their margins alone: the surface goes on beyond these."""

    def connections(self, fold: float) -> csr_array:
        """How strongly patches are connected, 1 at most: weakly across concave folds."""
        points, normals = self.points[self.touching.T], self.normals[self.touching.T]
        away = points[1] - points[0]
        away /= np.linalg.norm(away, axis=1, keepdims=True).clip(1e-12)
        concave = -((normals[1] - normals[0]) * away).sum(axis=1).clip(max=0)
        strengths = np.exp(-((fold * concave) ** 2)) + 1e-6
        return symmetric(strengths, self.touching, len(self.points))

    def pieces(self) -> csr_array:
        """How strongly patches are connected that are alike, 1 at most.

        Mean shift over patches that touch flattens shades and textures, and sharpens edges of
        colours and folds (Comaniciu, Meer: Mean shift, PAMI 2002).
        """
        lab = lab_from_rgb(torch.from_numpy(self.colors)).numpy()
        looks = np.hstack([lab / PIECE_SHADE, self.normals / PIECE_BEND])
        count = len(looks)
        for _ in range(PIECE_SHIFTS):
            near = np.exp(-self._differences(looks))
            weights = symmetric(near, self.touching, count) + eye_array(count)
            looks = (weights @ looks) / weights.sum(axis=1)[:, None]
        strengths = np.exp(-PIECE_EDGES * self._differences(looks)) + 1e-6
        return symmetric(strengths, self.touching, count)

    def _differences(self, looks: Float[np.ndarray, "K D"]) -> Float[np.ndarray, " P"]:
        """Squared distances of patches that touch."""
        one, other = self.touching.T
        return ((looks[one] - looks[other]) ** 2).sum(axis=1)


def symmetric(
    values: Float[np.ndarray, " P"], pairs: Int[np.ndarray, "P 2"], count: int
) -> csr_array:
    """The symmetric matrix with a value for each pair."""
    upper = coo_array((values, (pairs[:, 0], pairs[:, 1])), (count, count))
    return csr_array(upper + upper.T)


@cached_while_alive  # more clicks on the same splat
def surface_of(splats: Splats, cameras: Cameras) -> SurfaceGraph:
    """The graph over the surface of a splat on the CPU."""
    bare, margin = geometry_only(splats), int(PATCH)
    found, margins, sums = [], list[torch.Tensor](), torch.zeros(len(splats), 4)
    for camera in track(small_views(cameras), "finding the surface"):
        shown, (image, _) = depth_map(bare, camera), render(bare, camera, sh_degree=0)
        found.append(surface_points(shown, image.clamp(0, 1), grazing=GRAPH_GRAZING))
        valid = shown.reliable(GRAPH_GRAZING)
        inner = torch.zeros_like(valid)
        inner[margin:-margin, margin:-margin] = True
        margins.append(~inner[valid])
        known = torch.cat([shown.points * valid[..., None], valid[..., None]], dim=-1)
        sums += pixels_in(bare, camera, [known])
    points, normals, colors, sizes, _ = map(torch.cat, zip(*found, strict=True))
    if len(points) < MIN_POINTS * MIN_PATCHES:
        raise NothingToPick("Hardly any Gaussian shows in the views. Select by --box3d.")
    edge = PATCH * float(sizes.median())
    at_margin = torch.cat(margins)[:, None].expand(-1, 3)
    values = (each.double() for each in (points, colors, normals, at_margin))
    counts, means = average_in_voxels(edge, *values)
    kept = (each[counts >= MIN_POINTS].numpy() for each in (counts.double(), *means))
    weights, points, colors, normals, at_margin = kept
    tree = KDTree(points)
    touching = tree.query_pairs(GRAPH_TOUCH * edge, output_type="ndarray")
    beside = symmetric(np.ones(len(touching)), touching, len(points))
    normals = normals + beside @ normals
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
    planes = find_planes(points, normals, weights, PLANE_THICKEST * edge, np.random.default_rng(0))
    flat = np.zeros(len(points), bool)
    for plane in planes:
        flat |= np.abs(plane.heights(points)) < plane.thickness
    solid = symmetric((~flat[touching].any(axis=1)).astype(float), touching, len(points))
    solid.eliminate_zeros()
    parts = connected_components(solid, directed=False)[1]
    lone = np.bincount(parts)[parts] < MIN_PATCHES
    shown = sums[:, :3] / sums[:, 3:].clamp(min=UNSEEN_PIXELS)
    off = (shown - splats.means).norm(dim=1)
    reach = splats.scales.exp().amax(dim=1) + GRAPH_TOUCH * edge
    seen = ((sums[:, 3] > UNSEEN_PIXELS) & (off < reach)).numpy()  # not through what hides it
    places = torch.where(torch.from_numpy(seen)[:, None], shown, splats.means).double().numpy()
    owners = np.asarray(tree.query(places, workers=-1)[1])
    for plane in planes:  # what an object hides of a plane is not the object's
        below = np.flatnonzero(~seen & (np.abs(plane.heights(places)) < PLANE_THICKEST * edge))
        owners[below] = np.flatnonzero(flat)[KDTree(points[flat]).query(places[below])[1]]
    return SurfaceGraph(
        owners, points, colors, normals, touching, flat | lone, at_margin[:, 0] == 1
    )


def find_planes(
    points: Float[np.ndarray, "K 3"],
    normals: Float[np.ndarray, "K 3"],
    weights: Float[np.ndarray, " K"],
    thickness: float,
    rng: np.random.Generator,
) -> list[Plane]:
    """Large planes up to half a thickness, by RANSAC.

    On a plane normals scatter; the pieces that a slab cuts out of a curved surface turn.
    """
    free, planes = np.ones(len(points), bool), []
    while weights[free].sum() >= GRAPH_PLANE * weights.sum():
        rows = np.flatnonzero(free)
        some, tries = rng.choice(rows, PLANE_SAMPLE), rng.choice(rows, PLANE_TRIES)
        offsets = (points[tries] * normals[tries]).sum(axis=1)
        near = np.abs(points[some] @ normals[tries].T - offsets) < thickness
        along = np.abs(normals[some] @ normals[tries].T) > PLANE_UPRIGHT
        best = tries[(weights[some] @ (near & along)).argmax()]
        plane, on = Plane(points[best], normals[best], thickness), free
        for _ in range(3):
            on = free & (np.abs(plane.heights(points)) < thickness)
            on &= np.abs(normals @ plane.normal) > PLANE_ALONG
            if weights[on].sum() < GRAPH_PLANE * weights.sum():
                return planes
            centre = np.average(points[on], axis=0, weights=weights[on])
            away = points[on] - centre
            normal = np.linalg.eigh((away * weights[on, None]).T @ away)[1][:, 0]
            plane = Plane(centre, normal, thickness)
        free &= np.abs(plane.heights(points)) >= thickness
        if _turning(plane, points[on], normals[on], weights[on]) > PLANE_CURVED:
            continue
        scatter = PLANE_SCATTER * float(np.median(np.abs(plane.heights(points[on]))))
        scatter = float(np.clip(scatter, PLANE_THINNEST * thickness, thickness))
        planes.append(replace(plane, thickness=scatter))
    return planes


def _turning(
    plane: Plane,
    points: Float[np.ndarray, "K 3"],
    normals: Float[np.ndarray, "K 3"],
    weights: Float[np.ndarray, " K"],
) -> float:
    """The share of the variance of normals that goes linearly with the place along a plane."""
    along = np.linalg.svd(plane.normal[None])[2][1:].T
    tilts = (normals * np.sign(normals @ plane.normal)[:, None]) @ along
    root, places = np.sqrt(weights)[:, None], (points - plane.centre) @ along
    tilts = root * (tilts - np.average(tilts, axis=0, weights=weights))
    places = root * (places - np.average(places, axis=0, weights=weights))
    left = tilts - places @ np.linalg.lstsq(places, tilts)[0]
    return 1 - float((left**2).sum() / max((tilts**2).sum(), 1e-12))

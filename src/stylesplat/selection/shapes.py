"""Selections by distance: boxes and spheres, growing and shrinking, spreading over a surface."""

import torch
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.options import check_point
from stylesplat.rendering.weights import COVERED, expected_depth
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import EXTENT_FAINT, Extent, opaque_rows
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import overlapping, unproject
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.scene.world_offset import place_text


def in_box(splats: Splats, low: Float[Tensor, "3"], high: Float[Tensor, "3"]) -> Bool[Tensor, " N"]:
    """The Gaussians whose centres lie in a box along the world's axes, at least one.

    Its corners are relative to the splats' `world_offset`, as is all that follows here.
    """
    if not (low < high).all():
        raise StyleSplatError(
            f"The box {_span(splats, low, high)} is empty. Give the lower corner first."
        )
    inside = Extent(low.to(splats.means), high.to(splats.means)).contains(splats.means)
    return _some(inside, splats, f"the box {_span(splats, low, high)}")


def in_sphere(splats: Splats, centre: Float[Tensor, "3"], radius: float) -> Bool[Tensor, " N"]:
    """The Gaussians whose centres lie in a sphere, at least one."""
    if not radius > 0:
        raise StyleSplatError(f"A sphere cannot have the radius {radius:g}. Give more than 0.")
    inside = (splats.means - centre.to(splats.means)).norm(dim=1) <= radius
    place = place_text(centre, splats.world_offset)
    return _some(inside, splats, f"the sphere of radius {radius:g} around {place}")


@torch.no_grad()
def surface_point(
    splats: Splats, camera: Cameras, point: tuple[float, float]
) -> Float[Tensor, "3"]:
    """The world position of the surface at a pixel of one camera."""
    check_point(point, camera.size, camera.names[0])
    column, row = map(int, point)
    depths, alphas = expected_depth(splats, camera.crop((column, row), (1, 1)))
    if alphas[0, 0] < COVERED:
        raise StyleSplatError(
            f"Nothing solid shows at {point[0]:g},{point[1]:g} in {camera.names[0]}. Choose "
            "another pixel."
        )
    pixel = depths.new_tensor([[column + 0.5, row + 0.5]])
    return unproject(pixel, depths.flatten(), camera)[0]


def _some(inside: Tensor, splats: Splats, shape: str) -> Bool[Tensor, " N"]:
    if not inside.any():
        low, high = splats.means.amin(dim=0), splats.means.amax(dim=0)
        raise StyleSplatError(
            f"No Gaussian lies in {shape}. The splat reaches {_span(splats, low, high)}."
        )
    return inside


def _span(splats: Splats, low: Tensor, high: Tensor) -> str:
    start, end = (place_text(corner, splats.world_offset) for corner in (low, high))
    return f"from {start} to {end}"


SHAPE_SLACK = 1e-6  # of a distance, by which a search goes farther: it leaves out its bound
INSIDE = 0.9  # share of an object's solid centres that make up its extent; the rest may be strays


def grow(splats: Splats, picked: Bool[Tensor, " N"], share: float) -> Bool[Tensor, " N"]:
    """Add the Gaussians whose centres lie close to a picked one that is not faint.

    `share` is the distance as a share of the object's extent, up to 1.
    """
    others = (~picked).nonzero()[:, 0]
    surface = splats.means[opaque_rows(splats, picked)]
    close = within_distance(splats.means[others], surface, _reach(surface, share))
    return picked.index_fill(0, others[close], True)


def shrink(splats: Splats, picked: Bool[Tensor, " N"], share: float) -> Bool[Tensor, " N"]:
    """Remove the Gaussians whose centres lie close to one that is neither picked nor faint.

    `share` is the distance as a share of the object's extent, up to 1.
    """
    own = picked.nonzero()[:, 0]
    reach = _reach(splats.means[opaque_rows(splats, picked)], share)
    around = ~picked & (torch.sigmoid(splats.opacities) >= EXTENT_FAINT)
    close = within_distance(splats.means[own], splats.means[around], reach)
    if close.all():
        raise StyleSplatError(
            f"Shrinking by {share:g} of its extent leaves nothing of the object. Shrink it less."
        )
    return picked.index_fill(0, own[close], False)


def feather(splats: Splats, picked: Bool[Tensor, " N"], share: float) -> Float[Tensor, " N"]:
    """How much each Gaussian is picked, 0 to 1, by a border that fades.

    It is half where the border is, and fades over `share` of the object's extent on both sides.
    Faint Gaussians make no border.
    """
    solid = torch.sigmoid(splats.opacities) >= EXTENT_FAINT
    reach = _reach(splats.means[opaque_rows(splats, picked)], share) / 2
    weights = picked.to(splats.means)
    for inside in (True, False):
        rows = (picked == inside).nonzero()[:, 0]
        others = splats.means[(picked != inside) & solid]
        away = distances_to(splats.means[rows], others, reach).to(weights) / (2 * reach)
        weights[rows] = 0.5 + away.clamp(max=0.5) if inside else 0.5 - away.clamp(max=0.5)
    return weights


def robust_diameter(points: Float[Tensor, "M 3"]) -> float:
    """The diameter of the sphere around the median that holds nearly all points."""
    distances = (points - points.median(dim=0).values).norm(dim=1)
    return 2 * float(distances.sort().values[int(INSIDE * (len(points) - 1))])


def _reach(surface: Float[Tensor, "M 3"], share: float) -> float:
    if not 0 < share <= 1:
        raise StyleSplatError(
            f"Cannot grow or shrink an object by {share:g} of its extent. "
            "Give more than 0 and at most 1; 0.05 is 5 %."
        )
    return share * robust_diameter(surface)


def within_distance(
    points: Float[Tensor, "M 3"], others: Float[Tensor, "L 3"], reach: float
) -> Bool[Tensor, " M"]:
    """Which points lie within `reach` of one of the others."""
    return distances_to(points, others, reach) <= reach


def distances_to(
    points: Float[Tensor, "M 3"], others: Float[Tensor, "L 3"], reach: float
) -> Float[Tensor, " M"]:
    """How far the nearest of the others is from each point; infinite if farther than `reach`."""
    found = torch.full((len(points),), torch.inf, dtype=torch.float64)
    if not len(others):
        return found.to(points.device)
    bound = reach * (1 + SHAPE_SLACK)
    positions, targets = (each.detach().cpu().double() for each in (points, others))
    low, high = targets.amin(dim=0) - bound, targets.amax(dim=0) + bound
    rows = overlapping(positions, positions, low, high)
    tree = KDTree(targets.numpy())
    distances, _ = tree.query(positions[rows].numpy(), distance_upper_bound=bound, workers=-1)
    found[rows] = torch.from_numpy(distances)
    return found.to(points.device)


SHAPE_NEIGHBOURS = 12  # of a Gaussian, along which a selection spreads over a surface
# Differences of colour (0 to 1) and of 1 - |cosine| of normals, that double the length of a step
SPREAD_COLOR, SPREAD_BEND = 0.1, 0.15


@torch.no_grad()
def grow_by_similarity(
    splats: Splats, seeds: Bool[Tensor, " N"], reach: float
) -> Bool[Tensor, " N"]:
    """Spread over the surface around some Gaussians, as far as it looks the same.

    Where the colour or the direction of the surface changes, a step counts for more than its
    length, so that the selection stops at the borders of a thing first.

    Args:
        splats: The Gaussians.
        seeds: Where to begin.
        reach: How far to go on a surface without changes, in world units.
    """
    begun = splats.means[opaque_rows(splats, seeds)]
    rows = (
        within_distance(splats.means, begun, reach)
        & (torch.sigmoid(splats.opacities) >= EXTENT_FAINT)
        | seeds
    )
    rows = rows.nonzero()[:, 0]
    points = splats.means[rows].detach().cpu().double()
    _, neighbours = nearest_points(points, points, SHAPE_NEIGHBOURS)
    around = points[neighbours] - points[neighbours].mean(dim=1, keepdim=True)  # [M, k, 3]
    normals = torch.linalg.eigh(around.transpose(1, 2) @ around).eigenvectors[:, :, 0]
    colors = rgb_from_sh0(splats.sh0[rows, 0]).cpu().double()[neighbours].mean(dim=1)
    lengths = (points[:, None] - points[neighbours]).norm(dim=-1)
    bends = 1 - (normals[:, None] * normals[neighbours]).sum(dim=-1).abs()
    changes = (colors[:, None] - colors[neighbours]).norm(dim=-1)
    costs = lengths * (1 + (changes / SPREAD_COLOR) ** 2 + (bends / SPREAD_BEND) ** 2)
    starts = torch.arange(len(points))[:, None].expand_as(neighbours)
    graph = csr_array(
        (costs.flatten().clamp(min=1e-12), (starts.flatten(), neighbours.flatten())),
        shape=(len(points), len(points)),
    )
    begin = seeds[rows].nonzero()[:, 0].cpu().numpy()
    ways = dijkstra(graph, directed=False, indices=begin, limit=reach, min_only=True)
    found = torch.from_numpy(ways <= reach).to(rows.device)
    return torch.zeros_like(seeds).index_fill(0, rows[found], True)

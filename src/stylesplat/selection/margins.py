"""Changing a selection by distance: taking in what lies close to it, or giving up its rim."""

import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.content import FAINT, solid
from stylesplat.scene.overlap import overlapping
from stylesplat.scene.splats import Splats

SLACK = 1e-6  # of a distance, more than float32 rounds
INSIDE = 0.9  # share of an object's solid centres that make up its extent; the rest may be strays


def grow(splats: Splats, picked: Bool[Tensor, " N"], share: float) -> Bool[Tensor, " N"]:
    """The picked Gaussians and all others whose centres lie close to one that is picked.

    What is picked but hardly shows takes in nothing.

    Args:
        splats: The scene.
        picked: The object's Gaussians, at least one.
        share: How close, as a share of the object's extent.

    Raises:
        StyleSplatError: If the share is not above 0 and at most 1.
    """
    others = (~picked).nonzero()[:, 0]
    surface = splats.means[solid(splats, picked)]
    close = near(splats.means[others], surface, _reach(surface, share))
    return picked.index_fill(0, others[close], True)


def shrink(splats: Splats, picked: Bool[Tensor, " N"], share: float) -> Bool[Tensor, " N"]:
    """The picked Gaussians but those whose centres lie close to one that is not picked.

    What is not picked but hardly shows takes away nothing.

    Args:
        splats: The scene.
        picked: The object's Gaussians, at least one.
        share: How close, as a share of the object's extent.

    Raises:
        StyleSplatError: If the share is not above 0 and at most 1, or nothing is left.
    """
    own = picked.nonzero()[:, 0]
    reach = _reach(splats.means[solid(splats, picked)], share)
    around = ~picked & (torch.sigmoid(splats.opacities) >= FAINT)
    close = near(splats.means[own], splats.means[around], reach)
    if close.all():
        raise StyleSplatError(
            f"Shrinking by {share:g} of its extent leaves nothing of the object. Shrink it less."
        )
    return picked.index_fill(0, own[close], False)


def extent(points: Float[Tensor, "M 3"]) -> float:
    """The diameter of the sphere around the median that holds nearly all points."""
    distances = (points - points.median(dim=0).values).norm(dim=1)
    return 2 * float(distances.sort().values[int(INSIDE * (len(points) - 1))])


def _reach(surface: Float[Tensor, "M 3"], share: float) -> float:
    if not 0 < share <= 1:
        raise StyleSplatError(
            f"Cannot grow or shrink an object by {share:g} of its extent. "
            "Give more than 0 and at most 1; 0.05 is 5 %."
        )
    return share * extent(surface)


def near(
    points: Float[Tensor, "M 3"], others: Float[Tensor, "L 3"], reach: float
) -> Bool[Tensor, " M"]:
    """Which points lie at most so far from one of the others."""
    bound = reach * (1 + SLACK)  # the search excludes its bound, so it is a little wider
    nobody = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    if not len(others):
        return nobody
    low, high = others.amin(dim=0) - bound, others.amax(dim=0) + bound
    room = SLACK * torch.maximum(low.abs(), high.abs())  # float32 rounds these sums
    rows = overlapping(points, points, low - room, high + room)
    positions, targets = (each.detach().cpu().double().numpy() for each in (points[rows], others))
    distances, _ = KDTree(targets).query(positions, distance_upper_bound=bound, workers=-1)
    return nobody.index_fill(0, rows[torch.from_numpy(distances <= reach).to(rows.device)], True)

"""Splitting Gaussians that are too large to carry a stroke: colour paints no finer than they are.

A Gaussian gives way to a grid of smaller ones along its axes, whose sum is nearly its own shape.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.rendering import constants as const
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import ObjectView

COUNTS = (1, 3, 5, 7, 9)  # of children along an axis: odd, so that one keeps the centre
SPANS = (0.0, 1.06, 1.69, 2.0, 2.2)  # how far the outermost lie, in the parent's deviations
OVERLAP = 0.64  # deviation of a child, in distances between them: less shows ripples
FINE_ENOUGH = 1.5  # pixels of deviation: strokes are wider at the sizes that features see
HARDLY_SEEN = 0.05  # share of the rendering weight that is spread over Gaussians not worth it
BISECTIONS = 7
BASE = 10  # more than the largest count
DIGITS = (BASE**2, BASE, 1)
MAX_OPACITY = 0.995  # of a child; more would make its logit as good as infinite


@dataclass(frozen=True)
class Split:
    """A scene in which some Gaussians gave way to smaller ones."""

    splats: Splats
    """Parents' rows hold the child at their centre; the other children follow all others."""
    parents: Int[Tensor, " N"]
    """The row before the split that each row comes from."""


@torch.no_grad()
def split_large(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    *,
    max_growth: float,
) -> Split:
    """Split picked Gaussians that look large, until all are fine enough or the cap is reached.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        views: Linear views of the object, at the size at which features are matched.
        max_growth: Bound of the object's number of Gaussians, as a multiple.
    """
    sizes, weights = screen_sizes(splats, views)
    ranked = weights.sort()
    seen_much = ranked.values.cumsum(0) > HARDLY_SEEN * weights.sum()
    worthwhile = torch.zeros_like(picked).index_copy(0, ranked.indices, seen_much)
    room = int((max_growth - 1) * int(picked.sum()))
    counts = _counts_that_fit(sizes, worthwhile, torch.sigmoid(splats.opacities), room)
    return _divide(splats, counts)


def unsplit(splats: Splats, split: Split, rows: Int[Tensor, " R"]) -> Split:
    """A split in which some Gaussians are whole again.

    Args:
        splats: The scene before.
        split: After.
        rows: Which ones, before.
    """
    whole = torch.zeros(len(splats), dtype=torch.bool, device=rows.device)
    whole[rows] = True
    kept = ~whole[split.parents]
    kept[: len(splats)] = True
    after = split.splats[kept].with_rows(rows, splats[rows].tensors())
    return Split(after, split.parents[kept])


def screen_sizes(
    splats: Splats, views: Sequence[ObjectView]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
    """How long each axis looks in pixels, where a Gaussian shows; and how much it shows."""
    weights = splats.means.new_zeros(len(splats))
    sizes = splats.means.new_zeros(len(splats), 3)
    axes = rotation_matrices(splats.quats)
    for view in views:
        assert view.linear is not None  # the caller has kept these few
        shown, weight = view.linear.gaussians, view.linear.weights()
        away = splats.means[shown] - view.linear.origin
        distance = away.norm(dim=1, keepdim=True)
        along = torch.einsum("ni,nij->nj", away / distance, axes[shown])
        across = (1 - along.square()).clamp(min=0).sqrt()
        pixels = splats.scales[shown].exp() * across * float(view.camera.Ks[0, 0, 0]) / distance
        weights.index_add_(0, shown, weight)
        sizes.index_add_(0, shown, pixels * weight[:, None])
    return sizes / weights.clamp(min=1e-9)[:, None], weights


def _counts_that_fit(
    sizes: Tensor, worthwhile: Tensor, opacities: Tensor, room: int
) -> Int[Tensor, "N 3"]:
    """Children along each axis, for the finest size at which they do not outgrow their room."""

    def fits(wanted: float) -> bool:
        counts = _counts(sizes, worthwhile, wanted)
        grown = [int(_visible(opacities[rows], c).sum()) - len(rows) for c, rows in _groups(counts)]
        return sum(grown) <= room

    low, high = math.log(FINE_ENOUGH), math.log(float(sizes.max()) + FINE_ENOUGH)
    if fits(FINE_ENOUGH):
        return _counts(sizes, worthwhile, FINE_ENOUGH)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if fits(math.exp(middle)) else (middle, high)
    return _counts(sizes, worthwhile, math.exp(high))


def _counts(sizes: Tensor, worthwhile: Tensor, wanted: float) -> Tensor:
    """Enough children that each looks about as large as wanted."""
    shrinks = sizes.new_tensor([_child(index)[1] for index in range(len(COUNTS))])
    # the count whose size comes nearest, as ratios
    errors = (sizes[:, :, None] * shrinks / wanted).log().abs()
    index = torch.where(worthwhile[:, None] & (sizes > wanted), errors.argmin(dim=2), 0)
    return torch.tensor(COUNTS, device=sizes.device)[index]


def _groups(counts: Int[Tensor, "N 3"]) -> Iterator[tuple[tuple[int, ...], Tensor]]:
    """The rows to split, by their numbers of children."""
    codes = (counts * counts.new_tensor(DIGITS)).sum(dim=1)  # quicker to tell apart than rows
    for code in codes.unique().tolist():
        kind = tuple(code // digit % BASE for digit in DIGITS)
        if math.prod(kind) > 1:
            yield kind, (codes == code).nonzero()[:, 0]


def _heights(combination: tuple[int, ...]) -> Float[Tensor, " children"]:
    """The peaks of all children, as shares of the parent's opacity."""
    x, y, z = (_child(COUNTS.index(n))[2] for n in combination)
    return (x[:, None, None] * y[:, None] * z).flatten()


def _visible(opacities: Tensor, combination: tuple[int, ...]) -> Bool[Tensor, "R children"]:
    """Which children are opaque enough to be drawn at all."""
    return opacities[:, None] * _heights(combination).to(opacities) >= const.MIN_ALPHA


def _divide(splats: Splats, counts: Int[Tensor, "N 3"]) -> Split:
    everyone = torch.arange(len(splats), device=splats.device)
    centred, children, parents = {k: t.clone() for k, t in splats.tensors().items()}, [], [everyone]
    for combination, rows in _groups(counts):
        visible = _visible(torch.sigmoid(splats.opacities[rows]), combination)
        middle = visible.shape[1] // 2
        centre = torch.full_like(rows, middle)
        middles = _children_at(splats[rows], combination, centre).tensors()
        for name, tensor in centred.items():
            tensor[rows] = middles[name]
        visible[:, middle] = False
        places, which = visible.T.nonzero(as_tuple=True)
        children.append(_children_at(splats[rows[which]], combination, places))
        parents.append(rows[which])
    tensors = {
        name: torch.cat([tensor, *(child.tensors()[name] for child in children)])
        for name, tensor in centred.items()
    }
    return Split(replace(splats, **tensors), torch.cat(parents))


def _children_at(
    parents: Splats, combination: tuple[int, ...], places: Int[Tensor, " R"]
) -> Splats:
    """One child of each Gaussian, at some place of its grid, the last axis counted first."""
    ladders = [_child(COUNTS.index(n)) for n in combination]
    grid = torch.cartesian_prod(*(offsets for offsets, _, _ in ladders)).to(parents.means)
    shrink = parents.means.new_tensor([deviation for _, deviation, _ in ladders])
    axes = rotation_matrices(parents.quats)
    moved = torch.einsum("nij,nj->ni", axes, grid[places] * parents.scales.exp())
    heights = _heights(combination).to(parents.means)[places]
    opacities = (torch.sigmoid(parents.opacities) * heights).clamp(max=MAX_OPACITY)
    return replace(
        parents,
        means=parents.means + moved,
        scales=parents.scales + shrink.log(),
        opacities=torch.logit(opacities),
    )


@cache
def _child(index: int) -> tuple[Tensor, float, Tensor]:
    """For `COUNTS[index]` children: their offsets, common deviation and peaks.

    In units of the parent's; the peaks are those whose sum comes nearest to the parent's shape.
    """
    count, span = COUNTS[index], SPANS[index]
    if count == 1:
        return torch.zeros(1), 1.0, torch.ones(1)
    offsets = span * torch.linspace(-1, 1, count)
    offsets = (offsets - offsets.flip(0)) / 2  # the middle one is 0 to the bit
    deviation = OVERLAP * 2 * span / (count - 1)
    x = torch.linspace(-4, 4, 401)
    shapes = torch.exp(-((x[:, None] - offsets) / deviation).square() / 2)
    peaks = torch.linalg.lstsq(shapes, torch.exp(-x.square() / 2)[:, None]).solution[:, 0]
    return offsets, deviation, peaks

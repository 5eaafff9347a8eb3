"""Splitting Gaussians that are too large to carry a stroke: colour paints no finer than they are.

A Gaussian gives way to a grid of smaller ones along its axes, whose sum is nearly its own shape.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.rendering.contributions import Contributions
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.splats import Splats

COUNTS = (1, 3, 5, 7, 9)  # of children along an axis: odd, so that one keeps the centre
SPANS = (0.0, 1.06, 1.69, 2.0, 2.2)  # how far the outermost lie, in the parent's deviations
OVERLAP = 0.64  # deviation of a child, in distances between them: less shows ripples
FINE_ENOUGH = 1.5  # pixels of deviation: strokes are wider at the sizes that features see
HARDLY_SEEN = 0.05  # share of the rendering weight that is spread over Gaussians not worth it
BISECTIONS = 20
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
    views: Sequence[Contributions],
    *,
    focal: Sequence[float],
    max_growth: float,
) -> Split:
    """Split picked Gaussians that look large, until all are fine enough or the cap is reached.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        views: What they contribute, at the size at which features are matched.
        focal: Focal length of each view, in pixels.
        max_growth: Bound of the object's number of Gaussians, as a multiple.
    """
    sizes, weights = screen_sizes(splats, views, focal)
    ranked = weights.sort()
    seen_much = ranked.values.cumsum(0) > HARDLY_SEEN * weights.sum()
    worthwhile = torch.zeros_like(picked).index_copy(0, ranked.indices, seen_much) & picked
    room = int((max_growth - 1) * int(picked.sum()))
    counts = _counts_that_fit(sizes, worthwhile, room)
    return _divide(splats, counts)


def screen_sizes(
    splats: Splats, views: Sequence[Contributions], focal: Sequence[float]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
    """How long each axis looks in pixels, where a Gaussian shows; and how much it shows."""
    weights = splats.means.new_zeros(len(splats))
    sizes = splats.means.new_zeros(len(splats), 3)
    axes = rotation_matrices(splats.quats)
    for view, length in zip(views, focal, strict=True):
        shown, weight = view.gaussians, view.weights()
        away = splats.means[shown] - view.origin
        distance = away.norm(dim=1, keepdim=True)
        along = torch.einsum("ni,nij->nj", away / distance, axes[shown])
        across = (1 - along.square()).clamp(min=0).sqrt()
        pixels = splats.scales[shown].exp() * across * length / distance
        weights.index_add_(0, shown, weight)
        sizes.index_add_(0, shown, pixels * weight[:, None])
    return sizes / weights.clamp(min=1e-9)[:, None], weights


def _counts_that_fit(sizes: Tensor, worthwhile: Tensor, room: int) -> Int[Tensor, "N 3"]:
    """Children along each axis, for the finest size at which they do not outgrow their room."""
    counts = _counts(sizes, worthwhile, FINE_ENOUGH)
    if _growth(counts) <= room:
        return counts
    low, high = math.log(FINE_ENOUGH), math.log(float(sizes.max()) + FINE_ENOUGH)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if _growth(_counts(sizes, worthwhile, math.exp(middle))) <= room:
            high = middle
        else:
            low = middle
    return _counts(sizes, worthwhile, math.exp(high))


def _counts(sizes: Tensor, worthwhile: Tensor, wanted: float) -> Tensor:
    """Enough children that each looks about as large as wanted."""
    shrinks = sizes.new_tensor([_child(index)[1] for index in range(len(COUNTS))])
    # the count whose size comes nearest, as ratios
    errors = (sizes[:, :, None] * shrinks / wanted).log().abs()
    index = torch.where(worthwhile[:, None] & (sizes > wanted), errors.argmin(dim=2), 0)
    return torch.tensor(COUNTS, device=sizes.device)[index]


def _growth(counts: Tensor) -> int:
    return int((counts.prod(dim=1) - 1).sum())


def _divide(splats: Splats, counts: Int[Tensor, "N 3"]) -> Split:
    everyone = torch.arange(len(splats), device=splats.device)
    centred = splats
    children, parents = [], [everyone]
    for combination in {tuple(row) for row in counts[counts.prod(dim=1) > 1].tolist()}:
        rows = (counts == counts.new_tensor(combination)).all(dim=1).nonzero()[:, 0]
        ladders = [_child(COUNTS.index(n)) for n in combination]
        for place in product(*(range(n) for n in combination)):
            child = _child_at(splats[rows], ladders, place)
            if all(2 * p + 1 == n for p, n in zip(place, combination, strict=True)):
                centred = _replace_rows(centred, rows, child)
            else:
                children.append(child)
                parents.append(rows)
    tensors = {
        name: torch.cat([tensor, *(child.tensors()[name] for child in children)])
        for name, tensor in centred.tensors().items()
    }
    return Split(replace(splats, **tensors), torch.cat(parents))


def _child_at(
    parent: Splats, ladders: Sequence[tuple[Tensor, float, Tensor]], place: tuple[int, ...]
) -> Splats:
    """The children of some Gaussians at one place of their grids."""
    offset = torch.stack([ladders[k][0][place[k]] for k in range(3)]).to(parent.means)
    shrink = parent.means.new_tensor([ladders[k][1] for k in range(3)])
    height = math.prod(float(ladders[k][2][place[k]]) for k in range(3))
    moved = torch.einsum(
        "nij,nj->ni", rotation_matrices(parent.quats), offset * parent.scales.exp()
    )
    opacities = (torch.sigmoid(parent.opacities) * height).clamp(max=MAX_OPACITY)
    return replace(
        parent,
        means=parent.means + moved,
        scales=parent.scales + shrink.log(),
        opacities=torch.logit(opacities),
    )


def _replace_rows(splats: Splats, rows: Tensor, others: Splats) -> Splats:
    theirs = others.tensors()
    return replace(
        splats,
        **{name: t.index_copy(0, rows, theirs[name]) for name, t in splats.tensors().items()},
    )


@cache
def _child(index: int) -> tuple[Tensor, float, Tensor]:
    """For `COUNTS[index]` children: their offsets, common deviation and peaks.

    In units of the parent's; the peaks are those whose sum comes nearest to the parent's shape.
    """
    count, span = COUNTS[index], SPANS[index]
    if count == 1:
        return torch.zeros(1), 1.0, torch.ones(1)
    offsets = torch.linspace(-span, span, count)
    deviation = OVERLAP * 2 * span / (count - 1)
    x = torch.linspace(-4, 4, 401)
    shapes = torch.exp(-((x[:, None] - offsets) / deviation).square() / 2)
    peaks = torch.linalg.lstsq(shapes, torch.exp(-x.square() / 2)[:, None]).solution[:, 0]
    return offsets, deviation, peaks

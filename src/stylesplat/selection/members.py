"""Which Gaussians belong to an object: by their identities, without outliers, gaps filled.

All objects are found in one pass, without a table of all Gaussians by all labels.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.scene.content import FAINT
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.projection import overlapping
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import require_identities

SURE = (0.5, 0.9)  # probability above which a Gaussian is another object's; the background's
CONFIRMED = 0.9  # probability above which label maps confirm a Gaussian's label
AT_ONCE = 1 << 20  # Gaussians whose identities are gathered: 64 MB


@dataclass(frozen=True, eq=False)
class Members:
    """The Gaussians of some label ids by their identities alone."""

    splats: Splats
    likely: Mapping[int, Int[Tensor, " _"]]
    """By id the Gaussians whose probability exceeds the threshold."""
    confirmed: Mapping[int, Bool[Tensor, " _"]]
    """Whether label maps confirm them."""

    def mask(self, id: int) -> Bool[Tensor, " N"]:
        """The likely Gaussians of an object."""
        nobody = torch.zeros(len(self.splats), dtype=torch.bool, device=self.splats.device)
        return nobody.index_fill(0, self.likely[id], True)

    @torch.no_grad()
    def doubtful(self, id: int, rows: Int[Tensor, " M"]) -> Bool[Tensor, " M"]:
        """Which of some Gaussians are neither likely an object's nor surely anything else's."""
        _, classifier = require_identities(self.splats)
        limits = [SURE[each == BACKGROUND] if each != id else 1.0 for each in classifier.ids]
        limits = torch.tensor(limits).to(self.splats.means)
        parts = [(p <= limits).all(dim=1) for _, p in _probabilities(self.splats, rows)]
        return torch.cat(parts) & ~self.mask(id)[rows]


@torch.no_grad()
def members(splats: Splats, ids: Sequence[int], threshold: float) -> Members:
    """Find the Gaussians of some known label ids whose probability exceeds a threshold."""
    _, classifier = require_identities(splats)
    columns = torch.tensor([classifier.ids.index(id) for id in ids], device=splats.device)
    rows, numbers, confirmed = [], [], []
    every = torch.arange(len(splats), device=splats.device)
    for some, probabilities in _probabilities(splats, every):
        likely = probabilities.index_select(1, columns)
        row, number = (likely > threshold).nonzero(as_tuple=True)
        rows.append(some[row])
        numbers.append(number)
        confirmed.append(likely[row, number] > CONFIRMED)
    number = torch.cat(numbers)
    counts, order = torch.bincount(number, minlength=len(ids)).tolist(), number.argsort(stable=True)
    of_each, surely = (torch.cat(each)[order].split(counts) for each in (rows, confirmed))
    return Members(
        splats, dict(zip(ids, of_each, strict=True)), dict(zip(ids, surely, strict=True))
    )


@torch.no_grad()
def likeliest(splats: Splats) -> Int[Tensor, " N"]:
    """The most likely label id of each Gaussian."""
    identities, classifier = require_identities(splats)
    return classifier.likeliest(identities.detach())


def _probabilities(
    splats: Splats, rows: Int[Tensor, " M"]
) -> Iterator[tuple[Int[Tensor, " B"], Float[Tensor, "B K"]]]:
    """Some of the Gaussians at a time, and their probabilities of all classes."""
    identities, classifier = require_identities(splats)
    for some in rows.split(AT_ONCE):
        for part, scores in classifier.some_at_a_time(identities.index_select(0, some)):
            yield some[part], scores.softmax(dim=-1)


GAP_NEIGHBOURS = 16  # most of which are picked around a gap


@torch.no_grad()
def fill_gaps(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    doubtful: Callable[[Int[Tensor, " M"]], Bool[Tensor, " M"]],
) -> Bool[Tensor, " N"]:
    """Doubtful Gaussians most of whose neighbours are picked.

    Measured on the demo: they are 15 % of what shows of the vase, and 0.6 % of it lies beside it.
    """
    nobody = torch.zeros_like(picked)
    means, own = splats.means, picked.nonzero()[:, 0]
    if not (torch.sigmoid(splats.opacities[own]) >= FAINT).any():
        return nobody
    low, high = means[own].amin(dim=0), means[own].amax(dim=0)
    rows = overlapping(means, means, low, high)
    rows = rows[torch.sigmoid(splats.opacities[rows]) >= FAINT]
    others = rows[~picked[rows]]
    wanted = others[doubtful(others)]
    if not len(wanted):
        return nobody
    tree = KDTree(means[rows].double().cpu().numpy())
    places = means[wanted].double().cpu().numpy()
    _, near = tree.query(places, k=min(GAP_NEIGHBOURS + 1, len(rows)), workers=-1)
    near = torch.from_numpy(near).view(len(wanted), -1)[:, 1:]  # the first is each itself
    mostly = picked[rows[near.to(rows.device)]].double().mean(dim=1) > 0.5
    return nobody.index_fill(0, wanted[mostly], True)


OUTLIER_NEIGHBOURS = 20  # a floating clump of a dozen Gaussians must not confirm itself
# Standard deviations. Measured on eight objects of two scenes: 2 takes away most of what floats
# for 1% of the object's own visible area at most (a thin plaque: 2%); 0.5 takes a fifth of it.
SPREAD = 2.0
MIN_POINTS = 20  # fewer have no meaningful mean distance


def inliers(
    points: Float[Tensor, "N 3"],
    *,
    reaches: Float[Tensor, " N"] | None = None,
) -> Bool[Tensor, " N"]:
    """Which points lie about as close to their neighbours as the others do.

    A point is dropped when the logarithm of its mean distance to its nearest neighbours exceeds
    the mean of all points by `SPREAD` standard deviations. Densities in a splat span orders of
    magnitude; the logarithm makes them roughly normal and keeps a few distant floaters from
    inflating the deviation they are judged by. (PCL and Open3D use the plain distance.) Large
    Gaussians have far neighbours wherever they lie: `reaches` protects them.

    Args:
        points: Centres of one object's Gaussians.
        reaches: Mean distance to the neighbours up to which a point is kept in any case.

    Returns:
        True for the points to keep; sets of fewer than 20 are kept whole.
    """
    keep = torch.ones(len(points), dtype=torch.bool, device=points.device)
    if len(points) < MIN_POINTS:
        return keep
    neighbours = min(OUTLIER_NEIGHBOURS, len(points) // 2)
    positions = points.detach().cpu().double().numpy()
    distances, _ = KDTree(positions).query(positions, k=neighbours + 1, workers=-1)
    gaps = torch.from_numpy(distances[:, 1:]).mean(dim=1)  # column 0 is the point itself
    log_gaps = gaps.clamp(min=torch.finfo(torch.float32).tiny).log()
    usual = log_gaps <= log_gaps.mean() + SPREAD * log_gaps.std()
    if reaches is not None:
        usual |= gaps <= reaches.detach().cpu()
    return usual.to(points.device)

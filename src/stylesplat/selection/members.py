"""Which Gaussians every object has, by their identities: without a table of all by all labels."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import require_identities

SURE = (0.5, 0.9)  # probability above which a Gaussian is another object's; the background's
VOUCHED = 0.9  # probability above which label maps vouch for a Gaussian
AT_ONCE = 1 << 20  # Gaussians whose identities are gathered: 64 MB
ROUNDING = 1e-2  # of scores, by far
FEW = 0.5  # of the classes, of which it pays to compare them with the background first


@dataclass(frozen=True)
class Members:
    """What identities say of the objects of some label ids."""

    splats: Splats
    """The scene."""
    likely: Mapping[int, Int[Tensor, " _"]]
    """By id the Gaussians that are likelier its own than the threshold says."""
    vouched: Mapping[int, Bool[Tensor, " _"]]
    """Whether label maps vouch for these."""

    def mask(self, id: int) -> Bool[Tensor, " N"]:
        """The Gaussians that are likely an object's."""
        nobody = torch.zeros(len(self.splats), dtype=torch.bool, device=self.splats.device)
        return nobody.index_fill(0, self.likely[id], True)

    @torch.no_grad()
    def doubtful(self, id: int, rows: Int[Tensor, " M"]) -> Bool[Tensor, " M"]:
        """Which of some Gaussians are not likely an object's, and not surely anything else's."""
        _, classifier = require_identities(self.splats)
        limits = [SURE[each == BACKGROUND] if each != id else 1.0 for each in classifier.ids]
        limits = torch.tensor(limits).to(self.splats.means)
        parts = [(p <= limits).all(dim=1) for _, p in _probabilities(self.splats, rows)]
        return torch.cat(parts) & ~self.mask(id)[rows]


@torch.no_grad()
def members(splats: Splats, ids: Sequence[int], threshold: float) -> Members:
    """Find the Gaussians of some objects, all in one pass.

    Args:
        splats: Gaussians with identities.
        ids: Label ids that their classifier knows.
        threshold: Probability above which a Gaussian is likely an object's.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    _, classifier = require_identities(splats)
    columns = torch.tensor([classifier.ids.index(id) for id in ids], device=splats.device)
    rows, numbers, vouched = [], [], []
    for some, probabilities in _probabilities(splats, _possible(splats, columns, threshold)):
        likely = probabilities.index_select(1, columns)
        row, number = (likely > threshold).nonzero(as_tuple=True)
        rows.append(some[row])
        numbers.append(number)
        vouched.append(likely[row, number] > VOUCHED)
    number = torch.cat(numbers)
    counts, order = torch.bincount(number, minlength=len(ids)).tolist(), number.argsort(stable=True)
    of_each, surely = (torch.cat(each)[order].split(counts) for each in (rows, vouched))
    return Members(
        splats, dict(zip(ids, of_each, strict=True)), dict(zip(ids, surely, strict=True))
    )


@torch.no_grad()
def likeliest(splats: Splats) -> Int[Tensor, " N"]:
    """The label id that each Gaussian has most likely.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    identities, classifier = require_identities(splats)
    return classifier.likeliest(identities.detach())


def _possible(splats: Splats, columns: Int[Tensor, " L"], threshold: float) -> Int[Tensor, " M"]:
    """All Gaussians but those that are too likely background to be of some classes.

    No class is likelier than it were if there were only itself and the background.
    """
    identities, classifier = require_identities(splats)
    every = torch.arange(len(splats), device=splats.device)
    known = classifier.ids
    behind = known.index(BACKGROUND) if BACKGROUND in known else None
    if behind is None or behind in columns or len(columns) > FEW * len(known):
        return every
    weight = classifier.weight[columns] - classifier.weight[behind]
    bias = classifier.bias[columns] - classifier.bias[behind]
    least = torch.logit(torch.tensor(threshold)).item() - ROUNDING
    parts = zip(every.split(AT_ONCE), identities.split(AT_ONCE), strict=True)
    return torch.cat([rows[((p @ weight.T + bias) > least).any(dim=1)] for rows, p in parts])


def _probabilities(
    splats: Splats, rows: Int[Tensor, " M"]
) -> Iterator[tuple[Int[Tensor, " B"], Float[Tensor, "B K"]]]:
    """Some of the Gaussians at a time, and how likely these are of each class."""
    identities, classifier = require_identities(splats)
    for some in rows.split(AT_ONCE):
        for part, scores in classifier.some_at_a_time(identities.index_select(0, some)):
            yield some[part], scores.softmax(dim=-1)

"""Which Gaussians every object has, by their identities: without a table of all by all labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import require_identities

SURE = (0.5, 0.9)  # probability above which a Gaussian is another object's; the background's
VOUCHED = 0.9  # probability above which label maps vouch for a Gaussian
NOBODY = -1


@dataclass(frozen=True)
class Members:
    """What identities say of the objects of some label ids."""

    likely: Mapping[int, Int[Tensor, " _"]]
    """By id the Gaussians that are likelier its own than the threshold says."""
    vouched: Mapping[int, Bool[Tensor, " _"]]
    """Whether label maps vouch for these."""
    sure: Int[Tensor, " N"]
    """The label id that each Gaussian surely has, or -1."""

    def mask(self, id: int) -> Bool[Tensor, " N"]:
        """The Gaussians that are likely an object's."""
        nobody = torch.zeros_like(self.sure, dtype=torch.bool)
        return nobody.index_fill(0, self.likely[id], True)

    def doubtful(self, id: int) -> Bool[Tensor, " N"]:
        """Those that are not, and not surely another's."""
        doubtful = (self.sure == NOBODY) | (self.sure == id)
        return doubtful.index_fill(0, self.likely[id], False)


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
    identities, classifier = require_identities(splats)
    known = torch.tensor(classifier.ids, device=splats.device)
    columns = torch.tensor([classifier.ids.index(id) for id in ids], device=splats.device)
    limits = torch.tensor([SURE[id == BACKGROUND] for id in classifier.ids]).to(splats.means)
    rows, numbers, vouched, sure = [], [], [], []
    for part, scores in classifier.some_at_a_time(identities):
        probabilities = scores.softmax(dim=-1)
        surely = probabilities > limits
        sure.append(torch.where(surely.any(dim=1), known[surely.int().argmax(dim=1)], NOBODY))
        likely = probabilities.index_select(1, columns)
        row, number = (likely > threshold).nonzero(as_tuple=True)
        rows.append(part.start + row)
        numbers.append(number)
        vouched.append(likely[row, number] > VOUCHED)
    number = torch.cat(numbers)
    counts, order = torch.bincount(number, minlength=len(ids)).tolist(), number.argsort(stable=True)
    of_each, surely = (torch.cat(each)[order].split(counts) for each in (rows, vouched))
    return Members(
        dict(zip(ids, of_each, strict=True)), dict(zip(ids, surely, strict=True)), torch.cat(sure)
    )


@torch.no_grad()
def likeliest(splats: Splats) -> Int[Tensor, " N"]:
    """The label id that each Gaussian has most likely.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    identities, classifier = require_identities(splats)
    return classifier.likeliest(identities)

"""Nearest-neighbour feature matching (NNFM), the loss of ARF (Zhang et al. 2022), and its search.

The search takes candidates in a compressed space and ranks these exactly.
"""

from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numba
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel

DIMENSIONS = 64  # of the compressed space; its matches cost less than 0.1 % of the loss
MATCH_CANDIDATES = 4  # that are compared exactly
SIMILARITIES_AT_ONCE = {"cpu": 2**22, "cuda": 2**26}  # bounds features x style features
MATCH_KINDS = 32  # of style features, in balanced searches
MATCH_ROUNDS = 12  # that find them
REMEMBERED = 0.8  # of the usage before: a view shows only a part of the object
BALANCE = 0.5  # what a search adds to the cosines of a kind that had no match, by its share
MATCH_MOST = 0.5  # of what is added: with .3 lines stay away from what is dark


def nnfm_loss(
    feats: Float[Tensor, "P D"],
    style_feats: Float[Tensor, "Q D"],
) -> Float[Tensor, ""]:
    """Mean cosine distance from each feature to its nearest style feature, searched exhaustively.

    The matches are constants to the gradient (ARF, Zhang et al. 2022). The formula printed in the
    StyleSplat paper lacks the "1 -".
    """
    matches = most_similar(feats, F.normalize(style_feats, dim=1))
    return cosine_distance(feats, style_feats[matches])


def cosine_distance(feats: Float[Tensor, "P D"], others: Float[Tensor, "P D"]) -> Float[Tensor, ""]:
    """The mean over rows of 1 minus the cosine, in float32 or more."""
    return cosine_distance_of_units(unit_rows(feats), unit_rows(others))


def cosine_distance_of_units(
    feats: Float[Tensor, "P D"], others: Float[Tensor, "P D"]
) -> Float[Tensor, ""]:
    """The same for rows of length 1."""
    return (1 - (feats * others).sum(dim=1)).mean()


def unit_rows(feats: Float[Tensor, "P D"]) -> Float[Tensor, "P D"]:
    """The rows with length 1, in float32 or more."""
    return F.normalize(feats.to(torch.promote_types(feats.dtype, torch.float32)), dim=1, eps=1e-8)


class Potentials(NamedTuple):
    """What balanced searches have learned of a style's kinds of features."""

    usage: Float[Tensor, " K"]
    """How many of the last matches each kind had, of 1."""
    favour: Float[Tensor, " K"]
    """What is added to its cosines."""


@dataclass(frozen=True, eq=False)
class StyleIndex:
    """Style features, prepared for the search of nearest neighbours by cosine.

    Searches may be balanced: kinds of features that were matched more often than the style has
    them are favoured less in the next search, and the other way round. Else a flat area matches
    the few flat features of a style of lines. This is dual ascent of semi-discrete optimal
    transport (Genevay et al. 2016), its potentials bounded.
    """

    directions: Float[Tensor, "Q D"]
    """The features, of length 1."""
    units: Float[Tensor, "Q D"]
    """The same in float32, of length 1 however `directions` are rounded."""
    basis: Float[Tensor, "D B"]
    """The principal directions of the features, which keep most of their cosines."""
    compressed: Float[Tensor, "B R"]
    """The features in that basis; R is Q rounded up to whole vectors, the rest are 0."""
    kinds: Int[Tensor, " Q"]
    """The kind of each feature."""
    shares: Float[Tensor, " K"]
    """How many of the style's features each kind has, of 1."""

    @property
    def is_balanced(self) -> bool:
        return len(self.shares) > 1

    def no_favour(self) -> Potentials:
        """The potentials before the first search."""
        return Potentials(self.shares, torch.zeros_like(self.shares))

    @torch.no_grad()
    def nearest(
        self, feats: Float[Tensor, "P D"], potentials: Potentials
    ) -> tuple[Int[Tensor, " P"], Potentials]:
        """The rows of (almost always) the most similar style features, and the next potentials."""
        favour = potentials.favour.index_select(0, self.kinds)
        if self.directions.device.type == "cpu":
            found = self._search(feats, favour)
        else:
            found = most_similar(feats, self.directions, favour if self.is_balanced else None)
        return found, self._next(potentials, found)

    def _next(self, potentials: Potentials, found: Int[Tensor, " P"]) -> Potentials:
        if not self.is_balanced or len(found) == 0:
            return potentials
        each = self.shares.new_full((len(found),), 1 / len(found))
        used = torch.zeros_like(self.shares).index_add_(0, self.kinds.index_select(0, found), each)
        usage = potentials.usage.lerp(used, 1 - REMEMBERED)
        favour = potentials.favour.add(self.shares - usage, alpha=BALANCE).clamp(
            -MATCH_MOST, MATCH_MOST
        )
        return Potentials(usage, favour)

    def _search(
        self, feats: Float[Tensor, "P D"], favour: Float[Tensor, " Q"]
    ) -> Int[Tensor, " P"]:
        lengths = feats.float().norm(dim=1, keepdim=True)
        columns = self.compressed.shape[1]
        table = torch.cat([self.compressed, F.pad(favour, (0, columns - len(favour)))[None]])
        queries = torch.cat([feats.float() @ self.basis, lengths], dim=1)
        rows = max(1, SIMILARITIES_AT_ONCE["cpu"] // columns)
        found = []
        for chunk, query in zip(feats.split(rows), queries.split(rows), strict=True):
            candidates = torch.zeros(len(chunk), MATCH_CANDIDATES, dtype=torch.long)
            similarities = (query @ table).flatten().numpy()
            largest_columns(similarities, columns, len(self.directions), candidates.numpy())
            few = self.directions.index_select(0, candidates.flatten())
            few = few.view(*candidates.shape, feats.shape[1])
            exact = torch.einsum("pd,pkd->pk", chunk, few) + query[:, -1:] * favour[candidates]
            found.append(candidates.gather(1, exact.argmax(dim=1, keepdim=True))[:, 0])
        return torch.cat(found)


@torch.no_grad()
def build_index(
    style_feats: Float[Tensor, "Q D"], dtype: torch.dtype, *, balanced: bool = False
) -> StyleIndex:
    """Prepare style features for searches with features of this precision."""
    directions = F.normalize(style_feats.float(), dim=1)
    _, vectors = torch.linalg.eigh(directions.T @ directions)
    basis = vectors[:, -DIMENSIONS:].contiguous()  # eigenvalues ascend
    padding = -len(directions) % vec.LANES
    compressed = F.pad((directions @ basis).T, (0, padding)).contiguous()
    kinds = _kinds(directions @ basis, MATCH_KINDS if balanced else 1)
    shares = torch.bincount(kinds) / len(kinds)
    directions = directions.to(dtype)
    return StyleIndex(directions, unit_rows(directions), basis, compressed, kinds, shares)


def _kinds(points: Float[Tensor, "Q B"], count: int) -> Int[Tensor, " Q"]:
    """The cluster of each point (k-means, Lloyd 1982); the first centres are at equal distances."""
    centres = points[torch.linspace(0, len(points) - 1, count).long()]
    kinds = torch.zeros(len(points), dtype=torch.long, device=points.device)
    for _ in range(MATCH_ROUNDS):
        kinds = (points @ centres.T - centres.square().sum(dim=1) / 2).argmax(dim=1)
        sizes = torch.bincount(kinds, minlength=count)[:, None]
        sums = torch.zeros_like(centres).index_add_(0, kinds, points)
        centres = torch.where(sizes > 0, sums / sizes.clamp(min=1), centres)
    return kinds


@torch.no_grad()
def most_similar(
    feats: Float[Tensor, "P D"],
    directions: Float[Tensor, "Q D"],
    favour: Float[Tensor, " Q"] | None = None,
) -> Int[Tensor, " P"]:
    """The row of the most similar of some directions (of length 1), searched exhaustively.

    What favours a row is added to its cosines.
    """
    rows = max(1, SIMILARITIES_AT_ONCE[feats.device.type] // len(directions))
    columns = directions.T.to(feats.dtype)
    found = []
    for chunk in feats.split(rows):
        similar = chunk @ columns
        if favour is not None:
            similar = torch.addr(similar, chunk.float().norm(dim=1), favour)
        found.append(similar.argmax(dim=1))
    return found[0] if len(found) == 1 else torch.cat(found)


@no_type_check
@kernel
def largest_columns(flat, stride, count, found):
    """Write to `found` [P, K] the columns of the largest of the first `count` numbers of rows."""
    for row in numba.prange(found.shape[0]):
        best = np.full(found.shape[1], -np.inf, np.float32)
        start = row * stride
        for column in range(0, stride, vec.LANES):
            lanes = vec.load_vec(flat, start + column)
            better = vec.bits(vec.greater(lanes, best[-1]))
            while better != 0:
                place = column + vec.lowest_bit(better)
                better &= better - 1
                if place < count and flat[start + place] > best[-1]:
                    insert(best, found[row], flat[start + place], place)


@no_type_check
@inner
def insert(best, columns, value, column):
    """Insert a number into the best, which descend."""
    slot = best.shape[0] - 1
    while slot > 0 and best[slot - 1] < value:
        best[slot], columns[slot] = best[slot - 1], columns[slot - 1]
        slot -= 1
    best[slot], columns[slot] = value, column

"""The Gaussians of a scene found again in a splat that was edited elsewhere.

Rows may be missing, new or in another order, numbers rounded by a format, colours changed, and
the whole, or parts of it, turned, scaled and moved.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.scene.frames import SAME, Frame
from stylesplat.scene.similarity import similarity_of
from stylesplat.scene.splats import Splats

PARTS = 8  # that may have been moved each in its own way
LEAST = 16  # Gaussians that make a part
SURE = 0.6  # how like each other those of a part are on average; chance has .3
SAMPLE = 4000  # Gaussians that show how a part was moved
UNIQUE = 0.6  # of the distance to the second likest Gaussian, which the likest has to be below
ENOUGH = 0.98  # of what another motion explains, for none
CANDIDATES = 8  # Gaussians nearby, of which one may be the same
NEAR = 0.002  # of the splat's size; rounded places of compressed PLY are within
OWN_SIZE = 0.25  # of a Gaussian's largest standard deviation, if that is more
SIZES = 0.35  # of logarithms of standard deviations, beyond which it is another one
OPACITIES = 0.06  # likewise
COLORS = 0.3  # of constant bands, beyond which more difference tells no more
HINT = 0.3  # weight of colours, which may have been changed
ALIKE = 10  # times NEAR: motions that part Gaussians by no more are one, seen through rounding

Rows = Int[np.ndarray, " _"]
Part = tuple[Frame, Bool[np.ndarray, " M"]]
Numbers = Float[np.ndarray, "_ D"]


@dataclass(frozen=True)
class Match:
    """Which Gaussian of a scene each one of a splat is."""

    rows: Int[Tensor, " M"]
    """The scene's row; -1 if it is none of them."""
    parts: tuple[tuple[Frame, Bool[Tensor, " M"]], ...]
    """What was moved alike, the largest part first: how, from the scene's frame, and what it is."""


def match_gaussians(found: Splats, known: Splats) -> Match:
    """Find which Gaussian of a scene each one of a splat is.

    Places, sizes and opacities decide, so that colours may differ. What is not where it was is
    looked for by sizes, opacities and, if they tell more, colours; these pairs give the motion.

    Args:
        found: The splat.
        known: The scene's.
    """
    rows, parts = np.full(len(found), -1), list[Part]()
    for number in range(PARTS):
        if (rows >= 0).all() or not len(_free(rows, len(known))):
            break
        best = _best(found, known, rows, moved=number > 0)
        if best is None or not best.holds(len(found)):
            break
        rows[best.mine] = best.theirs
        _join(parts, best, found)
    kept = [(frame, torch.from_numpy(mask)) for frame, mask in parts]
    kept.sort(key=lambda part: -int(part[1].sum()))
    return Match(torch.from_numpy(rows), tuple(kept))


def _best(found: Splats, known: Splats, rows: Rows, *, moved: bool) -> "_Try | None":
    """What matches most: where it was, unless all is known to have moved, or moved as one."""
    still = None if moved else _matched(found, known, rows, SAME)
    if still is not None and still.total > ENOUGH * len(found):
        return still
    frame = _motion(found, known, rows)
    other = None if frame is None else _matched(found, known, rows, frame)
    if still is None or other is None:
        return still or other
    return still if still.total > ENOUGH * other.total else other


class _Try(NamedTuple):
    """What would be the same if the scene had been moved in some way."""

    frame: Frame
    mine: Rows
    theirs: Rows
    sureness: Float[np.ndarray, " _"]
    """1 is equal, 0 as unlike as can be."""

    @property
    def total(self) -> float:
        """How many are the same, those that are less alike counted less."""
        return float(self.sureness.sum())

    def holds(self, count: int) -> bool:
        """Whether it is more than chance."""
        return len(self.mine) >= min(LEAST, count) and float(self.sureness.mean()) > SURE


def _join(parts: list[Part], new: _Try, found: Splats) -> None:
    """Add a part, or more Gaussians of one that was moved in the same way."""
    mask = np.zeros(len(found), bool)
    mask[new.mine] = True
    means = found.means[torch.from_numpy(new.mine)].double()
    near = ALIKE * NEAR * _size(found.means.numpy())
    for number, (other, others) in enumerate(parts):
        apart = other.place(new.frame.inverse().place(means)) - means
        if float(apart.norm(dim=1).median()) < near:
            parts[number] = other, others | mask
            return
    parts.append((new.frame, mask))


def _matched(found: Splats, known: Splats, rows: Rows, frame: Frame) -> _Try:
    """Which of those that are free are the same if the scene was moved so."""
    rows, before, sureness = rows.copy(), rows >= 0, np.zeros(len(rows))
    while len(mine := np.flatnonzero(rows < 0)) and len(theirs := _free(rows, len(known))):
        costs, partners = _candidates(found[torch.from_numpy(mine)], known, theirs, frame)
        chosen = _assigned(costs, partners, len(known))
        there = chosen >= 0
        if not there.any():
            break
        cost = np.where(partners == chosen[:, None], costs, np.inf).min(axis=1)
        rows[mine[there]] = chosen[there]
        sureness[mine[there]] = np.exp(-cost[there])
        # Again: growth leaves copies at one place, which may be more than CANDIDATES
    new = np.flatnonzero((rows >= 0) & ~before)
    return _Try(frame, new, rows[new], sureness[new])


def _candidates(
    found: Splats, known: Splats, theirs: Rows, frame: Frame
) -> tuple[Float[np.ndarray, "M K"], Int[np.ndarray, "M K"]]:
    """How unlike each is to Gaussians that lie close to it, and which these are."""
    means, placed = found.means.numpy(), frame.place(known.means[theirs]).numpy()
    near, partners = _closest(placed, means, CANDIDATES)
    sizes, others = _sorted_sizes(found), _sorted_sizes(known)[theirs] + np.log(frame.scale)
    opacities = torch.sigmoid(found.opacities).numpy()
    alphas = torch.sigmoid(known.opacities[theirs]).numpy()
    reach = np.maximum(NEAR * _size(placed), OWN_SIZE * np.exp(sizes[:, -1]))[:, None]
    unlike = [
        near / reach,
        np.abs(sizes[:, None] - others[partners]).max(axis=2) / SIZES,
        np.abs(opacities[:, None] - alphas[partners]) / OPACITIES,
    ]
    colors = found.sh0.numpy() - known.sh0[:, 0].numpy()[theirs[partners]]
    hint = np.minimum(np.abs(colors).max(axis=2) / COLORS, 1)
    costs = np.sum(np.square([*unlike, HINT * hint]), axis=0)
    return np.where(np.max(unlike, axis=0) < 1, costs, np.inf), theirs[partners]


def _assigned(
    costs: Float[np.ndarray, "M K"], partners: Int[np.ndarray, "M K"], count: int
) -> Rows:
    """One partner for each, the likest first; -1 where all are taken or too unlike."""
    costs, rows = costs.copy(), np.full(len(costs), -1)
    for _ in range(costs.shape[1]):
        choice = costs.argmin(axis=1)
        each = np.arange(len(costs))
        cost, wanted = costs[each, choice], partners[each, choice]
        asking = np.flatnonzero((rows < 0) & np.isfinite(cost))
        if not len(asking):
            break
        ordered = asking[np.argsort(cost[asking], kind="stable")]
        _, first = np.unique(wanted[ordered], return_index=True)
        rows[ordered[first]] = wanted[ordered[first]]
        taken = np.zeros(count, bool)
        taken[rows[rows >= 0]] = True
        costs[taken[partners]] = np.inf
    return rows


def _motion(found: Splats, known: Splats, rows: Rows) -> Frame | None:
    """How the largest part of what is left was moved, if enough of it was moved alike."""
    mine, theirs = np.flatnonzero(rows < 0), _free(rows, len(known))
    if min(len(mine), len(theirs)) < LEAST:
        return None
    rng = np.random.default_rng(0)
    sample = rng.permutation(mine)[:SAMPLE]
    least = max(LEAST, len(sample) // 50)
    for colors in (True, False):  # those may have been changed
        looks, others = _looks(found, colors)[sample], _looks(known, colors)[theirs]
        spread = others.std(axis=0) + 1e-9
        away, partners = _closest(others / spread, looks / spread, 2)
        clear = away[:, 0] < UNIQUE * away[:, 1]
        before = known.means.double().numpy()[theirs[partners[clear, 0]]]
        after = found.means.double().numpy()[sample[clear]]
        moved = similarity_of(before, after, NEAR * _size(after)) if clear.any() else None
        if moved is not None and moved[1].sum() >= least:
            return moved[0]
    return None


def _looks(splats: Splats, colors: bool) -> Numbers:
    """What no motion changes: opacities, the sizes' proportions, and if wanted colours."""
    sizes = _sorted_sizes(splats)
    parts = [torch.sigmoid(splats.opacities)[:, None].numpy(), np.diff(sizes, axis=1)]
    return np.concatenate([*parts, splats.sh0[:, 0].numpy()] if colors else parts, axis=1)


def _closest(
    points: Numbers, places: Numbers, count: int
) -> tuple[Float[np.ndarray, "M K"], Int[np.ndarray, "M K"]]:
    """How far from each place the closest points are, and which."""
    away, partners = KDTree(points).query(places, k=min(count, len(points)))
    shape = len(places), -1
    return np.asarray(away).reshape(shape), np.asarray(partners).reshape(shape)


def _size(points: Numbers) -> float:
    """The longest side of a box around most of them."""
    return float(np.ptp(np.quantile(points, (0.02, 0.98), axis=0), axis=0).max())


def _sorted_sizes(splats: Splats) -> Numbers:
    return splats.scales.sort(dim=1).values.numpy()


def _free(rows: Rows, count: int) -> Rows:
    taken = np.zeros(count, bool)
    taken[rows[rows >= 0]] = True
    return np.flatnonzero(~taken)

"""The Gaussians of a scene found again in a splat that another program edited.

Rows may be missing, new or in another order, numbers rounded by a format, colours changed, and the
whole rotated, scaled and moved: one similarity and a k-d tree find each Gaussian's partner.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.scene.frames import SAME, Frame
from stylesplat.scene.splats import Splats

LEAST = 16  # Gaussians that show a match that is no chance
SURE = 0.6  # mean likeness of partners; chance has 0.3
SAMPLE = 4000  # Gaussians that show the motion
UNIQUE = 0.6  # of the distance to the second likest Gaussian, which the likest has to be below
ENOUGH = 0.98  # of what a motion explains, for none
CANDIDATES = 8  # neighbours, of which one may be the same
NEAR = 0.002  # of the splat's size; rounded positions of compressed PLY are within
# Largest differences of the same Gaussian: position over its largest standard deviation, logarithms
# of standard deviations, opacities; and the difference of colours beyond which more says no more
OWN_SIZE, SIZES, OPACITIES, COLORS = 0.25, 0.35, 0.06, 0.3
HINT = 0.3  # weight of colours, which may have been changed
TRIALS = 300  # of three pairs: if a fourth of the pairs is right, one run in a hundred fails
WHOLE = 1e-6  # a rotation and a scale this close to none are none

Rows = Int[np.ndarray, " _"]
Numbers = Float[np.ndarray, "_ D"]
Points = Float[np.ndarray, "M 3"]


@dataclass(frozen=True)
class Match:
    """Which Gaussian of a scene each one of a splat is."""

    rows: Int[Tensor, " M"]
    """The scene's row; -1 if it is none of them."""
    parts: tuple[tuple[Frame, Bool[Tensor, " M"]], ...]
    """The motion from the scene's frame, and which Gaussians made it; empty without a match."""


def match_gaussians(found: Splats, known: Splats) -> Match:
    """Find which Gaussian of a scene each one of a splat is.

    Positions, sizes and opacities decide, so colours may differ. Unless nearly all are where they
    were, pairs of equal size, opacity and, if possible, colour give the motion of the whole.

    Args:
        found: The splat.
        known: The scene's.
    """
    rows, likeness = _matched(found, known, SAME)
    frame = SAME
    if likeness.sum() <= ENOUGH * len(found):
        moved = _motion(found, known)
        if moved is not None:
            others, more = _matched(found, known, moved)
            if likeness.sum() <= ENOUGH * more.sum():
                rows, likeness, frame = others, more, moved
    here = rows >= 0
    chance = here.sum() < min(LEAST, len(found)) or likeness[here].mean() <= SURE
    if chance or not here.any():
        return Match(torch.full((len(found),), -1), ())
    return Match(torch.from_numpy(rows), ((frame, torch.from_numpy(here)),))


def _matched(found: Splats, known: Splats, frame: Frame) -> tuple[Rows, Float[np.ndarray, " M"]]:
    """The scene's row of each Gaussian after a motion, or -1; and their likeness, up to 1."""
    rows, likeness = np.full(len(found), -1), np.zeros(len(found))
    taken = np.zeros(len(known), bool)
    while len(mine := np.flatnonzero(rows < 0)) and not taken.all():
        theirs = np.flatnonzero(~taken)
        costs, partners = _candidates(found[torch.from_numpy(mine)], known, theirs, frame)
        chosen = _assigned(costs, partners, len(known))
        there = chosen >= 0
        if not there.any():
            break
        cost = np.where(partners == chosen[:, None], costs, np.inf).min(axis=1)
        rows[mine[there]], likeness[mine[there]] = chosen[there], np.exp(-cost[there])
        taken[chosen[there]] = True
        # Again: densification leaves copies at one position, which may be more than CANDIDATES
    return rows, likeness


def _candidates(
    found: Splats, known: Splats, theirs: Rows, frame: Frame
) -> tuple[Float[np.ndarray, "M K"], Int[np.ndarray, "M K"]]:
    """The costs of pairing each Gaussian with those close to it, and which these are."""
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
    each, taken = np.arange(len(costs)), np.zeros(count, bool)
    for _ in range(costs.shape[1]):
        choice = costs.argmin(axis=1)
        cost, wanted = costs[each, choice], partners[each, choice]
        asking = np.flatnonzero((rows < 0) & np.isfinite(cost))
        if not len(asking):
            break
        ordered = asking[np.argsort(cost[asking], kind="stable")]
        _, first = np.unique(wanted[ordered], return_index=True)
        rows[ordered[first]] = wanted[ordered[first]]
        taken[rows[rows >= 0]] = True
        costs[taken[partners]] = np.inf
    return rows


def _motion(found: Splats, known: Splats) -> Frame | None:
    """The motion of the whole, if enough of it moved alike."""
    if min(len(found), len(known)) < LEAST:
        return None
    sample = np.random.default_rng(0).permutation(len(found))[:SAMPLE]
    least = max(LEAST, len(sample) // 50)
    for colors in (True, False):  # these may have been changed
        looks, others = _invariants(found, colors)[sample], _invariants(known, colors)
        spread = others.std(axis=0) + 1e-9
        away, partners = _closest(others / spread, looks / spread, 2)
        clear = away[:, 0] < UNIQUE * away[:, 1]
        before = known.means.double().numpy()[partners[clear, 0]]
        after = found.means.double().numpy()[sample[clear]]
        moved = similarity_of(before, after, NEAR * _size(after)) if clear.any() else None
        if moved is not None and moved[1].sum() >= least:
            return moved[0]
    return None


def _invariants(splats: Splats, colors: bool) -> Numbers:
    """What no motion changes: opacities, the sizes' proportions and, if wanted, colours."""
    sizes = _sorted_sizes(splats)
    parts = [torch.sigmoid(splats.opacities)[:, None].numpy(), np.diff(sizes, axis=1)]
    return np.concatenate([*parts, splats.sh0[:, 0].numpy()] if colors else parts, axis=1)


def _closest(
    points: Numbers, places: Numbers, count: int
) -> tuple[Float[np.ndarray, "M K"], Int[np.ndarray, "M K"]]:
    """Distances of the closest points to each place, and which these are."""
    away, partners = KDTree(points).query(places, k=min(count, len(points)))
    shape = len(places), -1
    return np.asarray(away).reshape(shape), np.asarray(partners).reshape(shape)


def _size(points: Numbers) -> float:
    """The longest side of a box around most points."""
    return float(np.ptp(np.quantile(points, (0.02, 0.98), axis=0), axis=0).max())


def _sorted_sizes(splats: Splats) -> Numbers:
    return splats.scales.sort(dim=1).values.numpy()


def similarity_of(
    before: Points, after: Points, near: float, *, seed: int = 0
) -> tuple[Frame, Bool[np.ndarray, " M"]] | None:
    """The similarity that brings most points to their partners, most of whom may be wrong.

    Three pairs are drawn again and again (RANSAC, Fischler and Bolles 1981); the similarity that
    fits the most pairs is fitted to all of these (Kabsch 1976, with the scale of Umeyama 1991).

    Args:
        before: Points.
        after: The likely partner of each.
        near: How far from its partner a point may come to lie, in units of `after`.
        seed: Of the choice of pairs.

    Returns:
        The similarity and the pairs that fit it; None if no four do.
    """
    rng, best = np.random.default_rng(seed), np.zeros(len(before), bool)
    for _ in range(TRIALS if len(before) > 3 else 0):
        three = rng.choice(len(before), 3, replace=False)
        fits = _fitting(_fit(before[three], after[three]), before, after, near)
        best = fits if fits.sum() > best.sum() else best
    found = None
    for _ in range(3):
        if best.sum() < 4:
            return None
        found = _fit(before[best], after[best])
        best = _fitting(found, before, after, near)
    return found and (found, best)


def _fit(before: Points, after: Points) -> Frame:
    """The best similarity for pairs that are right, by least squares."""
    centres = before.mean(axis=0), after.mean(axis=0)
    one, other = before - centres[0], after - centres[1]
    spread = float((one**2).sum())
    if spread == 0:
        return Frame(torch.eye(3).double(), 1.0, torch.from_numpy(centres[1] - centres[0]))
    left, _, right = np.linalg.svd(other.T @ one)
    turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    scale = max(float((other * (one @ turn.T)).sum()) / spread, 1e-12)
    if abs(scale - 1) < WHOLE and np.abs(turn - np.eye(3)).max() < WHOLE:
        turn, scale = np.eye(3), 1.0
    shift = centres[1] - scale * centres[0] @ turn.T
    return Frame(torch.from_numpy(turn), scale, torch.from_numpy(shift))


def _fitting(frame: Frame, before: Points, after: Points, near: float) -> Bool[np.ndarray, " M"]:
    placed = frame.place(torch.from_numpy(before)).numpy()
    return np.linalg.norm(placed - after, axis=1) < near

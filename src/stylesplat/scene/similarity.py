"""The similarity between two sets of points, most of whose pairs may be wrong."""

import numpy as np
import torch
from jaxtyping import Bool, Float

from stylesplat.scene.frames import Frame

TRIALS = 300  # of three pairs: if a fourth of the pairs is right, one run in a hundred fails
REFINEMENTS = 3
WHOLE = 1e-6  # what is within this of no turn, no shift and the scale 1 is none

Points = Float[np.ndarray, "M 3"]


def similarity_of(
    before: Points, after: Points, near: float, *, seed: int = 0
) -> tuple[Frame, Bool[np.ndarray, " M"]] | None:
    """The turn, scale and shift that bring most points to their partners.

    Three pairs are drawn again and again (RANSAC, Fischler and Bolles 1981); what fits the most
    pairs is fitted to all of these (Kabsch 1976, with the scale of Umeyama 1991).

    Args:
        before: Points.
        after: The partner of each, as far as is known.
        near: How far from its partner a point may come to lie, in units of `after`.
        seed: Of the choice of pairs.

    Returns:
        The similarity and the pairs that fit it; None if no four do.
    """
    rng, best = np.random.default_rng(seed), np.zeros(len(before), bool)
    for _ in range(TRIALS if len(before) > 3 else 0):
        three = rng.choice(len(before), 3, replace=False)
        fits = _fitting(_fitted(before[three], after[three]), before, after, near)
        best = fits if fits.sum() > best.sum() else best
    found = None
    for _ in range(REFINEMENTS):
        if best.sum() < 4:
            return None
        found = _fitted(before[best], after[best])
        best = _fitting(found, before, after, near)
    return found and (found, best)


def _fitted(before: Points, after: Points) -> Frame:
    """The best for pairs that are right, by least squares."""
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

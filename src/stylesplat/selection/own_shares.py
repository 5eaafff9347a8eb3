"""What of a pick `stylize` paints, and how much: told before anything is painted."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.contacts import on_support
from stylesplat.selection.members import likeliest
from stylesplat.selection.soft_picks import find_places, looked_at, soft_shares
from stylesplat.selection.survey import survey


@torch.no_grad()
def own_shares(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    cameras: Cameras,
    *,
    labels: Int[Tensor, " N"] | None = None,
    seed: int = 0,
) -> Float[Tensor, " N"]:
    """How much of what each Gaussian paints belongs to the object that it was picked for.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        cameras: Views to look in.
        labels: The likeliest label of each Gaussian, if somebody has looked.
        seed: Of the planes that are tried for what the object stands on.

    Returns:
        Shares in 0..1: 0 for what lies on the surface that the object stands on, for haze and for
        floaters, and for all that is not picked.
    """
    own = picked & ~on_support(splats, picked, seed=seed)
    return soft_shares(splats, own, find_places(splats, own, cameras, labels))


class OwnShares:
    """The same of one object after the other: of a large scene only what matters to each."""

    def __init__(self, splats: Splats, cameras: Cameras) -> None:
        self._splats, self._cameras = splats, cameras
        self._survey = survey(splats, looked_at(cameras))
        self._labels = None
        if self._survey is not None and splats.classifier is not None:
            self._labels = likeliest(splats)

    def of(self, picked: Bool[Tensor, " N"]) -> Float[Tensor, " N"]:
        """As `own_shares`.

        Args:
            picked: The object's Gaussians.
        """
        if self._survey is None or not picked.any():
            return own_shares(self._splats, picked, self._cameras)
        rows = self._survey.around(picked)
        labels = None if self._labels is None else self._labels[rows]
        shares = own_shares(self._splats[rows], picked[rows], self._cameras, labels=labels)
        return shares.new_zeros(len(picked)).index_copy_(0, rows, shares)

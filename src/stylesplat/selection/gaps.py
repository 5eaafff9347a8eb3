"""Gaps in a pick: Gaussians amid an object that label maps have left in doubt."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.scene.content import FAINT
from stylesplat.scene.overlap import overlapping
from stylesplat.scene.splats import Splats

NEIGHBOURS = 16  # most of which are picked around a gap


@torch.no_grad()
def amid(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    doubtful: Callable[[Int[Tensor, " M"]], Bool[Tensor, " M"]],
) -> Bool[Tensor, " N"]:
    """Gaussians that are not picked, but most of whose neighbours are.

    Measured on the demo: they are 15 % of what shows of the vase, and 0.6 % of it lies beside it.

    Args:
        splats: The scene.
        picked: The object's Gaussians so far.
        doubtful: Says which of some others may be the object's.
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
    _, near = tree.query(places, k=min(NEIGHBOURS + 1, len(rows)), workers=-1)
    near = torch.from_numpy(near).view(len(wanted), -1)[:, 1:]  # the first is each itself
    mostly = picked[rows[near.to(rows.device)]].double().mean(dim=1) > 0.5
    return nobody.index_fill(0, wanted[mostly], True)

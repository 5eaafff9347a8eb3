"""Mending: the colours of some Gaussians continued from those around them, in closed form."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.content import EXTENT_FAINT
from stylesplat.scene.splats import Splats

MEND_NEIGHBOURS = 8  # of each Gaussian, that it is the mean of
TETHER = 1e-3  # of a neighbour's weight: what ties each Gaussian to the nearest one that is known
MOST_MENDED = 40_000  # Gaussians: the equations of more take minutes


@torch.no_grad()
def mended_bands(
    splats: Splats, broken: Bool[Tensor, " N"], places: Int[Tensor, " M"]
) -> tuple[Float[Tensor, "M 1 3"], Float[Tensor, "M _ 3"]]:
    """Bands of colour for some Gaussians that are harmonic: each is the mean of its neighbours.

    Where they end they go over into the solid Gaussians that are not broken, so that a scratch is
    filled from both of its sides (Laplace's equation on the graph of neighbours, weights 1 / d^2).

    Args:
        splats: All Gaussians, as they look.
        broken: Those whose colours nobody is to take on.
        places: The Gaussians that get new colours.

    Raises:
        StyleSplatError: If nothing solid is left around them, or they are too many.
    """
    if len(places) > MOST_MENDED:
        raise StyleSplatError(
            f"This is too much to mend at once: {len(places):,} Gaussians. Use a smaller brush."
        )
    known = (torch.sigmoid(splats.opacities) >= EXTENT_FAINT) & ~broken
    sources = known.nonzero()[:, 0]
    if not len(sources):
        raise StyleSplatError("Nothing solid is left around the brush. Mend a smaller part.")
    own, others = (splats.means[rows].double().cpu().numpy() for rows in (places, sources))
    points = np.concatenate([own, others])
    count = min(MEND_NEIGHBOURS + 1, len(points))
    away, neighbours = KDTree(points).query(own, k=count, workers=-1)
    tethered, nearest = KDTree(others).query(own, workers=-1)
    starts = np.repeat(np.arange(len(own)), count)
    weights = 1 / np.maximum(away.ravel(), 1e-9) ** 2
    weights[neighbours.ravel() == starts] = 0  # itself
    ends = np.concatenate([neighbours.ravel(), nearest + len(own)])
    starts = np.concatenate([starts, np.arange(len(own))])
    weights = np.concatenate([weights, TETHER / np.maximum(tethered, 1e-9) ** 2])
    graph = csc_array((weights, (starts, ends)), shape=(len(own), len(points)))
    inner = graph[:, : len(own)]
    inner = inner.maximum(inner.T)
    outer = graph[:, len(own) :]
    degrees = np.asarray(inner.sum(axis=1)).ravel() + np.asarray(outer.sum(axis=1)).ravel()
    bands = torch.cat([splats.sh0, splats.shN], dim=1)[sources].flatten(1).double().cpu().numpy()
    solved = splu(csc_array(diags_array(degrees) - inner)).solve(outer @ bands)
    found = torch.from_numpy(solved).to(splats.sh0).view(len(own), -1, 3)
    return found[:, :1], found[:, 1:]

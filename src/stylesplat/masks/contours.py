"""Contours of masks moved to edges of the photo: random walks in a band around them.

A pixel belongs to the side that walks from it reach first (Grady: Random walks for image
segmentation, PAMI 2006). Walks hardly cross edges, and end at any step with a small probability on
the side that the mask says, which holds contours where the photo shows none.
"""

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.ndimage import distance_transform_edt, maximum_filter
from scipy.sparse import coo_array, csr_array, diags_array

from stylesplat.scene.capture import Mask
from stylesplat.selection.surface_cut import solve_symmetric

ColorLevels = UInt8[np.ndarray, "H W 3"]


def window_around(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """The rows and columns that a mask spans, with a margin."""
    spans = ((int(places.min()), int(places.max())) for places in np.nonzero(mask))
    rows, columns = (slice(max(0, first - margin), last + 1 + margin) for first, last in spans)
    return rows, columns


BAND = 0.06  # of the root of the mask's area: how far a contour may move
MIN_BAND = 2.0  # pixels: at least so far
THIN = 2.0  # pixels from the contour, from which the middle of a leg is the object's for certain
CONTOUR_EDGE = 8.0  # levels of colour (of 255) over which a connection drops to 1/e
WEAKEST = 1e-5  # connection across the strongest edge
TRUST = 0.005  # probability that a walk ends at a pixel, over that of a step in plain colour


def move_to_edges(colors: ColorLevels, mask: Mask) -> Mask:
    """A mask whose contour lies at edges of the photo, where there are some nearby."""
    inside = mask.numpy()
    if not inside.any() or inside.all():
        return mask
    width = max(MIN_BAND, BAND * float(inside.sum()) ** 0.5)
    window = window_around(inside, int(width) + 2)
    before = inside[window]
    within, outside = (np.asarray(distance_transform_edt(side)) for side in (before, ~before))
    is_middle = (within >= THIN) & (within == maximum_filter(within, size=3))
    undecided = ((within + outside <= width) & ~is_middle).ravel()
    belongs = before.ravel().astype(float)
    graph = _pixel_graph(colors[window].astype(float))[undecided]
    system = csr_array(diags_array(graph.sum(axis=1) + TRUST) - graph[:, undecided])
    ends = graph @ (belongs * ~undecided) + TRUST * belongs[undecided]
    belongs[undecided] = solve_symmetric(system, ends)
    moved = inside.copy()
    moved[window] = (belongs > 0.5).reshape(before.shape)
    return torch.from_numpy(moved)


def _pixel_graph(colors: Float[np.ndarray, "h w 3"]) -> csr_array:
    """How easily walks pass between neighbouring pixels, by their numbers."""
    number = np.arange(colors[..., 0].size).reshape(colors.shape[:2])
    ones, others, passes = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for axis in (0, 1):
        apart = (np.diff(colors, axis=axis) ** 2).sum(axis=-1)
        passes.append((np.exp(-apart / CONTOUR_EDGE**2) + WEAKEST).ravel())
        ones.append(np.delete(number, -1, axis).ravel())
        others.append(np.delete(number, 0, axis).ravel())
    one, other, strength = (np.concatenate(each) for each in (ones, others, passes))
    half = coo_array((strength, (one, other)), (number.size, number.size)).tocsr()
    return csr_array(half + half.T)

"""Soft picks: the share of each picked Gaussian's contribution to renders that is its object's.

A pick says yes or no, but its Gaussians do not end where the object does: some straddle its
contour, some are haze or float beside it. All views together show where they contribute.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, Int32
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import Contributions, contributions
from stylesplat.rendering.shares import COVERED, without_looks
from stylesplat.rendering.visibility import LARGE, bounds, in_view, pixel_bounds, visible
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.projection import crop, overlapping
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.contacts import on_support
from stylesplat.selection.identities import render_labels
from stylesplat.selection.members import likeliest

VIEWS = 16  # more give the same shares
LONGER_SIDE = 320  # pixels of a view; twice as many give the same shares
LABELLED = 0.25  # coverage from which a pixel is the object's if its label says so, too
# The part of a Gaussian's contribution inside the object at which its share begins to exceed 0,
# and reaches 1. Measured on the fox and the demo: .5 and .9 leave more smudges on the wall, .8 and
# .97 eat into the fur.
OUTSIDE, INSIDE = 0.6, 0.95
UNSEEN = 0.02  # pixels in all views; a Gaussian that contributes less takes its neighbours' part
NEIGHBOURS = 9
NO_IDS = torch.zeros(0, dtype=torch.long)


@dataclass(frozen=True)
class ObjectPixels:
    """An object's pixels in one view."""

    camera: Cameras
    pixels: Bool[Tensor, "H W"]
    painted: Float[Tensor, "N 2"]
    """The contribution of each picked Gaussian to these pixels, and to the whole image."""


@torch.no_grad()
def find_places(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    cameras: Cameras,
    labels: Int[Tensor, " N"] | None = None,
) -> list[ObjectPixels]:
    """Find an object's pixels in some views.

    They are where the picked Gaussians cover half of a pixel, or less if the pixel has a label that
    most Gaussians of the pick, and few others, have.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        cameras: Views to choose from.
        labels: The likeliest label of each Gaussian, if known.
    """
    # contributions exist on the CPU only
    splats, picked = splats.to("cpu"), picked.cpu()
    bare = without_looks(splats)
    if labels is None and splats.identities is not None and splats.classifier is not None:
        labels = likeliest(splats)
    ids = NO_IDS if labels is None else _own_ids(labels, picked)
    alone = bare[picked.nonzero()[:, 0]]

    def find(camera: Cameras) -> ObjectPixels:
        view = contributions(bare, camera, picked, in_view(alone, camera).box(camera))
        pixels = view.coverage > COVERED
        unsure = (view.coverage > LABELLED) & ~pixels
        if len(ids) and unsure.any():
            pixels |= unsure & torch.isin(_labels_around(splats, camera, unsure), ids)
        return ObjectPixels(camera, pixels, _painted(view, pixels, len(splats)))

    views = sampled_views(cameras)
    return [*track(at_once(find, views), "finding contours", total=len(views))]


def sampled_views(cameras: Cameras) -> list[Cameras]:
    """The views in which shares are measured, one by one, at a small size."""
    return [cameras[row].at_most(LONGER_SIDE) for row in evenly(range(len(cameras)), VIEWS)]


def soft_shares(
    splats: Splats, picked: Bool[Tensor, " N"], places: Sequence[ObjectPixels]
) -> Float[Tensor, " N"]:
    """The share of each Gaussian's contribution that belongs to the object.

    Haze and floaters, which lie mostly outside over all views, get exactly 0; Gaussians well inside
    get exactly 1.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        places: The object's pixels, found for these Gaussians or for those that they came from.

    Returns:
        Shares in 0..1; 0 for all that is not picked.
    """
    inside = inside_parts(splats, picked, places)
    return ((inside - OUTSIDE) / (INSIDE - OUTSIDE)).clamp(0, 1)


@torch.no_grad()
def inside_parts(
    splats: Splats, picked: Bool[Tensor, " N"], places: Sequence[ObjectPixels]
) -> Float[Tensor, " N"]:
    """The part of each picked Gaussian's contribution inside the object, 0..1; 0 for the others."""
    sums = torch.stack([place.painted for place in places]).sum(dim=0)
    inside, everywhere = sums.unbind(dim=1)
    means, mine = splats.means.cpu(), picked.cpu()
    parts = inside / everywhere.clamp(min=UNSEEN)
    seen = mine & (everywhere >= UNSEEN)
    unseen = mine & ~seen
    parts[unseen] = _of_neighbours(means[unseen], means[seen], parts[seen])
    return (parts * mine).to(splats.device)


def _painted(view: Contributions, pixels: Bool[Tensor, "H W"], count: int) -> Tensor:
    """The contribution of each Gaussian to some pixels, and to all."""
    sums = torch.stack([view.weights(pixels), view.weights()], dim=1)
    return sums.new_zeros(count, 2).index_copy_(0, view.gaussians, sums)


def _labels_around(splats: Splats, camera: Cameras, pixels: Bool[Tensor, "H W"]) -> Tensor:
    """The labels in a box around some pixels; background elsewhere."""
    low = [int(pixels.any(dim=axis).nonzero().min()) for axis in (0, 1)]
    high = [int(pixels.any(dim=axis).nonzero().max()) + 1 for axis in (0, 1)]
    cut = crop(camera, low, [b - a for a, b in zip(low, high, strict=True)])
    labels = torch.full(pixels.shape, BACKGROUND, dtype=torch.int32)
    labels[low[1] : high[1], low[0] : high[0]] = render_labels(splats, cut)
    return labels


def _own_ids(labels: Int[Tensor, " N"], picked: Bool[Tensor, " N"]) -> Tensor:
    """The labels most of whose Gaussians are picked."""
    ids, own = labels[picked].unique(return_counts=True)
    every = torch.stack([(labels == id).sum() for id in ids]) if len(ids) else own
    return ids[(2 * own > every) & (ids != BACKGROUND)]


def _of_neighbours(
    points: Float[Tensor, "M 3"], others: Float[Tensor, "L 3"], values: Float[Tensor, " L"]
) -> Float[Tensor, " M"]:
    """The median value of the nearest others; 0 if there are none."""
    count = min(NEIGHBOURS, len(others))
    if count == 0 or len(points) == 0:
        return points.new_zeros(len(points))
    from scipy.spatial import KDTree  # most objects need none, and it takes a while to import

    tree = KDTree(others.double().numpy())
    _, rows = tree.query(points.double().numpy(), k=count)
    return values[torch.from_numpy(rows).view(-1, count)].median(dim=1).values


MARGIN = 2  # pixels around what an object may reach
NEARBY = 0.25  # of an object's extent along each axis: what it stands on lies within


@dataclass(frozen=True)
class VisibleInView:
    """The visible Gaussians of one view, and the pixels that each may reach."""

    camera: Cameras
    rows: Int32[Tensor, " M"]
    low: Int32[Tensor, "M 2"]
    high: Int32[Tensor, "M 2"]


@dataclass(frozen=True)
class Survey:
    """What matters to each object of a large scene; every view is rendered once for all."""

    splats: Splats
    views: Sequence[VisibleInView]

    def around(self, picked: Bool[Tensor, " N"]) -> Int[Tensor, " M"]:
        """Rows of an object's Gaussians, those visible around its pixels, and those close by."""
        mine = picked.clone()
        own = self.splats[picked.nonzero()[:, 0]]
        for view in self.views:
            low, high = pixel_bounds(own, view.camera)
            shown = (low < high).all(dim=1)
            if shown.any():
                low, high = low[shown].amin(dim=0) - MARGIN, high[shown].amax(dim=0) + MARGIN
                mine[view.rows[overlapping(view.low, view.high, low + 1, high - 1)].long()] = True
        low, high = own.means.amin(dim=0), own.means.amax(dim=0)
        room = NEARBY * (high - low).norm()
        means = self.splats.means
        mine[overlapping(means, means, low - room, high + room)] = True
        return mine.nonzero()[:, 0]


@torch.no_grad()
def survey(splats: Splats, cameras: Sequence[Cameras]) -> Survey | None:
    """Render every view once; None for small scenes and on a GPU, where that saves no time."""
    if len(splats) < LARGE or splats.device.type != "cpu":
        return None
    bare = without_looks(splats)

    def look(camera: Cameras) -> VisibleInView:
        near = visible(in_view(bare, camera), camera)
        low, high = bounds(near.projected)
        return VisibleInView(camera, near.rows.int(), low.int(), high.int())

    found = at_once(look, cameras)
    return Survey(splats, [*track(found, "finding visible Gaussians", total=len(cameras))])


@torch.no_grad()
def own_shares(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    cameras: Cameras,
    *,
    labels: Int[Tensor, " N"] | None = None,
    seed: int = 0,
) -> Float[Tensor, " N"]:
    """Soft shares without the surface that the object stands on: what `stylize` would paint.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        cameras: Views to choose from.
        labels: The likeliest label of each Gaussian, if known.
        seed: Of the planes that are tried for the surface.

    Returns:
        Shares in 0..1: 0 for the surface, for haze and floaters, and for all that is not picked.
    """
    own = picked & ~on_support(splats, picked, seed=seed)
    return soft_shares(splats, own, find_places(splats, own, cameras, labels))


class OwnShares:
    """`own_shares` of one object after the other; of a large scene only what matters to each."""

    def __init__(self, splats: Splats, cameras: Cameras) -> None:
        self._splats, self._cameras = splats, cameras
        self._survey = survey(splats, sampled_views(cameras))
        self._labels = None
        if self._survey is not None and splats.classifier is not None:
            self._labels = likeliest(splats)

    def of(self, picked: Bool[Tensor, " N"]) -> Float[Tensor, " N"]:
        """The shares of an object's Gaussians."""
        if self._survey is None or not picked.any():
            return own_shares(self._splats, picked, self._cameras)
        rows = self._survey.around(picked)
        labels = None if self._labels is None else self._labels[rows]
        shares = own_shares(self._splats[rows], picked[rows], self._cameras, labels=labels)
        return shares.new_zeros(len(picked)).index_copy_(0, rows, shares)

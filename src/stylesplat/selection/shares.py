"""Soft picks: the share of each picked Gaussian's contribution to renders that is its object's.

A pick says yes or no, but its Gaussians do not end where the object does: some straddle its
contour, some are haze or float beside it. All views together show where they contribute.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, Int32
from torch import Tensor

from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.visibility import VISIBLE_LARGE, bounds, in_view, pixel_bounds, visible
from stylesplat.rendering.weights import COVERED, contributions, geometry_only
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import overlapping
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import labels_around

SHARE_VIEWS = 16  # more give the same shares
SHARE_LONGER_SIDE = 320  # pixels of a view; twice as many give the same shares
LABELLED = 0.25  # coverage from which a pixel is the object's if its label says so, too
# The part of a Gaussian's contribution inside the object at which its share begins to exceed 0,
# and reaches 1. Measured on the fox and the demo: .5 and .9 leave more smudges on the wall, .8 and
# .97 eat into the fur.
SHARE_OUTSIDE, SHARE_INSIDE = 0.6, 0.95
OWN_SHARE = 0.5  # share of a Gaussian that is the object's: one with less is not painted
UNSEEN_PIXELS = 0.02  # in all views together: a Gaussian with fewer goes with what is near it
SHARE_NEIGHBOURS = 9  # of such a Gaussian


@torch.no_grad()
def object_shares(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    cameras: Cameras,
    *,
    labels: Int[Tensor, " N"] | None = None,
) -> Float[Tensor, " N"]:
    """The share of each picked Gaussian's contribution to renders that belongs to the object.

    The object's pixels are those that the picked Gaussians cover by half, or by a quarter if the
    pixel has a label that most Gaussians of the pick, and few others, have. Haze and floaters,
    which lie mostly outside over all views, get exactly 0; Gaussians well inside get exactly 1.

    `labels` are the likeliest label ids, if they are known already.
    """
    bare, alone = geometry_only(splats), geometry_only(splats)[picked.nonzero()[:, 0]]
    labels = _likeliest(splats) if labels is None else labels
    ids = None if labels is None else _own_ids(labels, picked)

    def look(camera: Cameras) -> Float[Tensor, "N 2"]:
        """The contribution of each Gaussian to the object's pixels, and to all."""
        view = contributions(bare, camera, picked, in_view(alone, camera).box(camera))
        pixels = view.coverage > COVERED
        unsure = (view.coverage > LABELLED) & ~pixels
        if ids is not None and len(ids) and unsure.any():
            pixels |= unsure & torch.isin(labels_around(splats, camera, unsure), ids)
        return view.pixels_in(torch.stack([pixels, torch.ones_like(pixels)], dim=-1))

    found = per_view(look, small_views(cameras), "finding contours", splats.device)
    inside, everywhere = sum(found, splats.means.new_zeros(len(splats), 2)).unbind(dim=1)
    parts = inside / everywhere.clamp(min=UNSEEN_PIXELS)
    seen, unseen = picked & (everywhere >= UNSEEN_PIXELS), picked & (everywhere < UNSEEN_PIXELS)
    if seen.any() and unseen.any():
        _, near = nearest_points(splats.means[seen], splats.means[unseen], SHARE_NEIGHBOURS)
        parts[unseen] = parts[seen][near].median(dim=1).values
    return ((parts - SHARE_OUTSIDE) / (SHARE_INSIDE - SHARE_OUTSIDE)).clamp(0, 1) * picked


def small_views(cameras: Cameras) -> list[Cameras]:
    """The views in which shares are measured, at a small size."""
    rows = evenly_spaced(range(len(cameras)), SHARE_VIEWS)
    return [cameras[row].at_most(SHARE_LONGER_SIDE) for row in rows]


@torch.no_grad()
def _likeliest(splats: Splats) -> Int[Tensor, " N"] | None:
    """The most likely label id of each Gaussian, if they have identities."""
    if splats.identities is None or splats.classifier is None:
        return None
    return splats.classifier.likeliest(splats.identities.detach())


def _own_ids(labels: Int[Tensor, " N"], picked: Bool[Tensor, " N"]) -> Tensor:
    """The labels most of whose Gaussians are picked."""
    ids, own = labels[picked].unique(return_counts=True)
    known, counts = labels.unique(return_counts=True)
    every = counts[torch.searchsorted(known, ids)]
    return ids[(2 * own > every) & (ids != BACKGROUND)]


SHARE_MARGIN = 2  # pixels around what an object may reach


@dataclass(frozen=True, eq=False)
class Survey:
    """The visible Gaussians of a large scene in some views, found once for all objects."""

    splats: Splats
    views: Sequence[tuple[Cameras, Int32[Tensor, " _"], Int32[Tensor, "_ 2"], Int32[Tensor, "_ 2"]]]
    """Each with its visible Gaussians, and the lowest and highest pixel that each may reach."""

    def around(self, picked: Bool[Tensor, " N"]) -> Int[Tensor, " M"]:
        """Rows of an object's Gaussians, and of those that are visible around its pixels."""
        mine = picked.clone()
        own = self.splats[picked.nonzero()[:, 0]]
        for camera, rows, lows, highs in self.views:
            low, high = pixel_bounds(own, camera)
            shown = (low < high).all(dim=1)
            if shown.any():
                low, high = (
                    low[shown].amin(dim=0) - SHARE_MARGIN,
                    high[shown].amax(dim=0) + SHARE_MARGIN,
                )
                mine[rows[overlapping(lows, highs, low + 1, high - 1)].long()] = True
        return mine.nonzero()[:, 0]


@torch.no_grad()
def survey(splats: Splats, cameras: Sequence[Cameras]) -> Survey | None:
    """Survey a scene; None for small scenes and on a GPU, where that saves no time."""
    if len(splats) < VISIBLE_LARGE or splats.device.type != "cpu":
        return None
    bare = geometry_only(splats)

    def find(camera: Cameras) -> tuple[Cameras, Tensor, Tensor, Tensor]:
        near = visible(in_view(bare, camera), camera)
        low, high = bounds(near.projected)
        return camera, near.rows.int(), low.int(), high.int()

    return Survey(splats, [*per_view(find, cameras, "finding visible Gaussians")])


class OwnShares:
    """`object_shares` of several objects; in a large scene, on the Gaussians around each."""

    def __init__(self, splats: Splats, cameras: Cameras) -> None:
        self._splats, self._cameras = splats, cameras
        self._survey = survey(splats, small_views(cameras))
        self._labels = None if self._survey is None else _likeliest(splats)

    def of(self, picked: Bool[Tensor, " N"]) -> Float[Tensor, " N"]:
        """The shares of an object's Gaussians."""
        if self._survey is None or not picked.any():
            return object_shares(self._splats, picked, self._cameras)
        rows = self._survey.around(picked)
        labels = None if self._labels is None else self._labels[rows]
        shares = object_shares(self._splats[rows], picked[rows], self._cameras, labels=labels)
        return shares.new_zeros(len(picked)).index_copy_(0, rows, shares)

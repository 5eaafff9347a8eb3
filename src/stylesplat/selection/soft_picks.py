"""Soft picks: how much of what a Gaussian paints belongs to the object that it was picked for.

A pick says yes or no, but its Gaussians do not end where the object does: some straddle its
contour, some are haze or float beside it. What they paint is seen in all views together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import Contributions, contributions
from stylesplat.rendering.seen import seen
from stylesplat.rendering.shares import COVERED, without_looks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import render_labels
from stylesplat.selection.members import likeliest

VIEWS = 16  # that are looked at; more tell hardly more
LONGER_SIDE = 320  # pixels of a view; twice as many give the same shares
LABELLED = 0.25  # coverage from which a pixel is the object's if its label says so, too
# Parts of what a Gaussian paints that lie inside the object, up to which it is taken to lie outside
# altogether, and from which inside. Measured on the fox and the demo: .5 and .9 leave more smudges
# on the wall, .8 and .97 eat into the fur.
OUTSIDE, INSIDE = 0.6, 0.95
UNSEEN = 0.02  # pixels, of all views: what shows less takes after its neighbours
NEIGHBOURS = 9
NO_IDS = torch.zeros(0, dtype=torch.long)


@dataclass(frozen=True)
class Place:
    """Where an object is in one view."""

    camera: Cameras
    """The camera alone, at a modest size."""
    pixels: Bool[Tensor, "H W"]
    """The object's."""
    painted: Float[Tensor, "N 2"]
    """What each Gaussian of the pick that it was found for paints of them, and of the image."""


@torch.no_grad()
def find_places(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    cameras: Cameras,
    labels: Int[Tensor, " N"] | None = None,
) -> list[Place]:
    """Where an object is in some views.

    It is where the picked Gaussians cover half of a pixel, or less if its label is one that most
    Gaussians of the pick, and few others, have.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        cameras: Views to choose from.
        labels: The likeliest label of each Gaussian, if somebody has looked.
    """
    # contributions are known on the CPU only
    splats, picked = splats.to("cpu"), picked.cpu()
    bare = without_looks(splats)
    if labels is None and splats.identities is not None and splats.classifier is not None:
        labels = likeliest(splats)
    ids = NO_IDS if labels is None else _own_ids(labels, picked)
    alone = bare[picked.nonzero()[:, 0]]

    def find(camera: Cameras) -> Place:
        view = contributions(bare, camera, picked, seen(alone, camera).box(camera))
        pixels = view.coverage > COVERED
        unsure = (view.coverage > LABELLED) & ~pixels
        if len(ids) and unsure.any():
            pixels |= unsure & torch.isin(_labels_around(splats, camera, unsure), ids)
        return Place(camera, pixels, _painted(view, pixels, len(splats)))

    views = looked_at(cameras)
    return [*track(at_once(find, views), "looking for contours", total=len(views))]


def looked_at(cameras: Cameras) -> list[Cameras]:
    """Those of some views that objects are looked for in, one by one, at the size for that."""
    return [cameras[row].at_most(LONGER_SIDE) for row in evenly(range(len(cameras)), VIEWS)]


def soft_shares(
    splats: Splats, picked: Bool[Tensor, " N"], places: Sequence[Place]
) -> Float[Tensor, " N"]:
    """How much of what each Gaussian paints belongs to the object.

    Haze and floaters lie mostly outside, all views together, and get exactly 0; what lies well
    inside gets exactly 1.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        places: Where the object is, found for these Gaussians or for those that they came from.

    Returns:
        Shares in 0..1; 0 for all that is not picked.
    """
    inside = inside_parts(splats, picked, places)
    return ((inside - OUTSIDE) / (INSIDE - OUTSIDE)).clamp(0, 1)


@torch.no_grad()
def inside_parts(
    splats: Splats, picked: Bool[Tensor, " N"], places: Sequence[Place]
) -> Float[Tensor, " N"]:
    """The part of what each picked Gaussian paints that lies where the object is.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        places: Where the object is.

    Returns:
        Parts in 0..1; 0 for all that is not picked.
    """
    sums = torch.stack([place.painted for place in places]).sum(dim=0)
    inside, everywhere = sums.unbind(dim=1)
    means, mine = splats.means.cpu(), picked.cpu()
    parts = inside / everywhere.clamp(min=UNSEEN)
    seen = mine & (everywhere >= UNSEEN)
    unseen = mine & ~seen
    parts[unseen] = _of_neighbours(means[unseen], means[seen], parts[seen])
    return (parts * mine).to(splats.device)


@torch.no_grad()
def seen_anew(splats: Splats, picked: Bool[Tensor, " N"], places: Sequence[Place]) -> list[Place]:
    """The same places, and what the Gaussians of another scene paint there.

    Args:
        splats: The scene, whose Gaussians came from those that the places were found for.
        picked: The object's.
        places: Where the object is.
    """
    bare, picked = without_looks(splats.to("cpu")), picked.cpu()

    def see(place: Place) -> Place:
        view = contributions(bare, place.camera, picked)
        return replace(place, painted=_painted(view, place.pixels, len(splats)))

    return [*track(at_once(see, places), "looking at contours", total=len(places))]


def _painted(view: Contributions, pixels: Bool[Tensor, "H W"], count: int) -> Tensor:
    """What each Gaussian paints of some pixels, and of all."""
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

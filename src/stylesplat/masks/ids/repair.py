"""Ids of label maps made to agree in 3D: what shows the same Gaussians is the same object.

A tracker takes one object for another, loses it, or finds it anew under another id. On the
Gaussians of a splat all views meet, and outvote what single ones got wrong.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array
from torch import Tensor

from stylesplat.masks.ids.grouping import (
    SMALL,
    at_work,
    group_parts,
    mapped,
    parts_of,
    pixels_of,
)
from stylesplat.progress import track
from stylesplat.rendering.shares import PRIOR, largest_shown, scaled_rows
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND, Labels, OwnLabels, resize_labels
from stylesplat.scene.splats import Splats

ROUNDS = 3  # of votes of Gaussians for parts of label maps, and back
TWO = 0.25  # of a part of a label map, that must be another object for it to be cut
WHOLE = 0.5  # of what shows of an object, that is cut out of a part however large that is
LOST = 0.7  # of what an object covers in a view, below which the label map has missed some of it
NOTHING = 0.5  # how much a pixel of background counts: not to find an object is the usual mistake


@torch.no_grad()
def repair(splats: Splats, cameras: Cameras, maps: Sequence[OwnLabels]) -> list[OwnLabels]:
    """Make the ids of label maps agree over all views.

    Connected parts of label maps are grouped by the Gaussians that they show, whatever ids they
    had: an id that went over to another object is cut, ids of one object become one. Then every
    part takes the group that the Gaussians vote for, as all other views see them; parts that show
    two objects are cut, objects that a view has missed are filled in. Borders stay where they
    were drawn. What only one view shows is no object.

    Args:
        splats: A scene of the views; its labels do not matter.
        cameras: One per label map, of its size.
        maps: With ids that may differ from view to view.

    Returns:
        New label maps; ids count from 1, larger objects first.
    """
    repaired = group_parts(splats, cameras, maps)
    for _ in range(ROUNDS):
        if not _settle(splats, cameras, repaired):
            break
    return _renumbered(repaired)


def _settle(splats: Splats, cameras: Cameras, maps: list[OwnLabels]) -> bool:
    """Give every part of the label maps, in place, the id that all other views vote for.

    Returns:
        Whether that changed anything.
    """
    counted = track(maps, "votes for ids", unit="photo")
    votes = [pixels_of(splats, cameras[row], labels) for row, labels in enumerate(counted)]
    ids = torch.tensor(sorted({id for some, _ in votes for id in some}))
    columns = [torch.searchsorted(ids, torch.tensor(some)).numpy() for some, _ in votes]
    views = sum((np.isin(np.arange(len(ids)), some) for some in columns), np.zeros(len(ids), int))
    shape = len(splats), len(ids)
    own = [
        csr_array((each.data, some[each.indices], each.indptr), shape=shape)
        for some, (_, each) in zip(columns, votes, strict=True)
    ]
    total = csr_array(sum(own, csr_array(shape, dtype=np.float32)))
    total.data *= views[total.indices] > 1  # what one view alone shows must not spread to others
    changed = False
    for row, mine in enumerate(track(own, "checking ids in 3D", unit="photo")):
        others = csr_array((total - mine).maximum(0))
        shown, certainty = _shown(splats, cameras[row], others, mine.sum(axis=1) > 0)
        settled = _voted(maps[row], ids[shown].to(maps[row]), certainty)
        changed |= not torch.equal(settled, maps[row])
        maps[row] = settled
    return changed


def _shown(
    splats: Splats,
    camera: Cameras,
    votes: csr_array,
    visible: Bool[np.ndarray, " N"],
) -> tuple[Int[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The column that most Gaussians in a pixel vote for, background first, and their share."""
    votes.data[votes.indices == 0] *= NOTHING
    rows = np.arange(len(splats) + 1)
    prior = np.full(len(splats), PRIOR, np.float32), 0 * rows[1:], rows
    votes = votes + csr_array(prior, shape=votes.shape)
    shares = scaled_rows(votes, 1 / votes.sum(axis=1))
    counts = np.diff(shares.indptr)
    largest = shares.data == np.repeat(shares.max(axis=1).toarray(), counts)
    firsts = np.unique(shares.indices[largest & np.repeat(visible, counts)])
    columns = np.union1d([0], firsts)  # others win nowhere: less to render
    certainty, best = largest_shown(splats, at_work(camera), shares[:, columns])
    width, height = camera.size
    shown = resize_labels(torch.from_numpy(columns)[best], (height, width))
    return shown, resize_labels(certainty, (height, width))


def _voted(labels: Labels, shown: Labels, certainty: Float[Tensor, "H W"]) -> Labels:
    """A label map whose parts take the labels that show there, and the objects that it lacks."""
    voted, pixels = labels.clone(), labels.numel()
    areas = _areas(shown)
    for _, box, part in parts_of(labels):
        counts = _areas(shown[box][part])
        counts.pop(BACKGROUND, None)
        total = sum(counts.values())
        if 2 * total < part.sum():
            continue  # the views know no better
        large = [
            id
            for id, count in counts.items()
            if count >= TWO * total or count >= max(WHOLE * areas[id], SMALL * pixels)
        ]
        if len(large) > 1:
            voted[box][part] = _nearest(
                shown[box], part & torch.isin(shown[box], torch.tensor(large))
            )[part]
        else:
            voted[box][part] = max(counts, key=lambda id: counts[id])
    for id in areas:
        there = (shown == id) & (certainty > 0.5)
        known = (there & (voted == id)).sum()
        if id != BACKGROUND and there.sum() >= SMALL * pixels and known < LOST * there.sum():
            voted[there & (voted == BACKGROUND)] = id
    return voted


def _areas(labels: Int[Tensor, "..."]) -> dict[int, int]:
    ids, counts = labels.unique(return_counts=True)
    return dict(zip(ids.tolist(), counts.tolist(), strict=True))


def _nearest(labels: Labels, known: Bool[Tensor, "H W"]) -> Labels:
    """Where labels are not known, those of the nearest pixel where they are."""
    nearest = distance_transform_edt(~known.numpy(), return_distances=False, return_indices=True)
    assert nearest is not None  # so typed for calls that fill an array
    y, x = torch.from_numpy(nearest).long()
    return labels[y, x]


def _renumbered(maps: Sequence[OwnLabels]) -> list[OwnLabels]:
    """Ids from 1, by size; what is tiny wherever it shows, but for one view, is background."""
    sizes, shares = dict[int, int](), dict[int, list[float]]()
    for labels in maps:
        for id, count in _areas(labels).items():
            sizes[id] = sizes.get(id, 0) + count
            shares.setdefault(id, []).append(count / labels.numel())
    views = min(2, len(maps))
    seen = {id: sum(share >= SMALL for share in each) for id, each in shares.items()}
    objects = [id for id in sizes if id != BACKGROUND and seen[id] >= views]
    order = sorted(objects, key=lambda id: -sizes[id])
    new = dict.fromkeys(sizes, BACKGROUND) | {id: n for n, id in enumerate(order, start=1)}
    return [mapped(labels, new) for labels in maps]

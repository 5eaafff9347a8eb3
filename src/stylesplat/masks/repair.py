"""Ids of label maps made to agree in 3D: parts that show the same Gaussians are the same object.

A tracker takes one object for another, loses it, or finds it anew under another id. On the
Gaussians of a splat all views meet, and outvote what single ones got wrong.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, find_objects
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from stylesplat.photo_libraries import cv2
from stylesplat.progress import task, track
from stylesplat.rendering.weights import PRIOR, label_pixels, render_argmax
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Labels, OwnLabels, resize_labels
from stylesplat.scene.splats import Splats

REPAIR_SIDE = 640  # pixels of a photo's longer side that suffice to tell what it shows
SMALLEST_PART = 5e-4  # of a photo: a smaller part, or mask, is a fragment and is dropped
REPAIR_FAINT = 1e-2  # pixels of a Gaussian in a part that do not matter
# Grouping of parts
REPAIR_SAME_IOU = 0.3  # of two groups of parts, in what both sides see, from which they are one
REPAIR_BLOCK = 128  # parts that are compared with all others at once
COMMON_SIGHT = 0.2  # share of the smaller part that both views must see for their IoU to count
# In which groups of parts must have had the same id, for that to be no accident
REPAIR_MIN_PHOTOS = 3
# Votes of Gaussians for parts, and back
REPAIR_ROUNDS = 3
SECOND_OBJECT = 0.25  # share of a part that must be another object for it to be cut
WHOLE_OBJECT = 0.5  # share of an object's visible pixels that is cut out of a part of any size
REPAIR_LOST = 0.7  # share of an object in a view; with less the label map has missed some of it
# Weight of a pixel of background: not to find an object is the usual mistake
BACKGROUND_WEIGHT = 0.5

Window = tuple[slice, slice]


@torch.no_grad()
def repair_ids(splats: Splats, cameras: Cameras, maps: Sequence[OwnLabels]) -> list[OwnLabels]:
    """Make the ids of label maps agree over all views.

    Connected parts of label maps are grouped by the Gaussians that they show, whatever ids they
    had: an id that went over to another object is cut, ids of one object become one. Then every
    part takes the group that the Gaussians vote for, as all other views see them; parts that show
    two objects are cut, objects that a view has missed are filled in. Borders stay where they
    were drawn. What only one view shows is no object. New ids count from 1, larger objects first.
    """
    repaired = _group_parts(splats, cameras, maps)
    for _ in range(REPAIR_ROUNDS):
        if not _vote(splats, cameras, repaired):
            break
    return _renumber(repaired)


def _group_parts(splats: Splats, cameras: Cameras, maps: Sequence[OwnLabels]) -> list[OwnLabels]:
    """Label maps whose ids are groups of connected parts that show the same Gaussians."""
    numbered, rows, roots, view_of, id_of = [], [], [], [], []
    for row, labels in enumerate(track(maps, "what parts show", unit="photo")):
        parts, own_ids = _number_parts(labels, first=len(view_of) + 1)
        ids, pixels = _gaussian_pixels(splats, cameras[row], parts)
        root = np.sqrt(pixels.sum(axis=1))
        own = pixels[:, [ids.index(part) for part in own_ids]]
        rows.append(csr_array(own.multiply(1 / np.maximum(root, 1e-6)[:, None]).T))
        roots.append(root)
        view_of += [row] * len(own_ids)
        id_of += own_ids.values()
        numbered.append(parts)
    if not view_of:
        return numbered
    views = np.array(view_of)
    groups = cluster_parts(csr_array(vstack(rows)), np.stack(roots), views)
    groups = _unite_by_id(groups, views, np.array(id_of))
    ids = {BACKGROUND: BACKGROUND} | {part: int(k) + 1 for part, k in enumerate(groups, start=1)}
    return [map_labels(parts, ids) for parts in numbered]


def _gaussian_pixels(
    splats: Splats, camera: Cameras, labels: Labels
) -> tuple[tuple[int, ...], csr_array]:
    """The ids of a label map, background first, and their pixels of every Gaussian, [N, K]."""
    small = camera.at_most(REPAIR_SIDE)
    width, height = small.size
    ids, pixels = label_pixels(splats, small, [(0, resize_labels(labels, (height, width)))])
    pixels = csr_array(pixels * (labels.numel() / (width * height)))
    pixels.data[pixels.data <= REPAIR_FAINT] = 0
    pixels.eliminate_zeros()
    return ids, pixels


def connected_parts(labels: Labels) -> Iterator[tuple[int, Window, Bool[Tensor, "h w"]]]:
    """The connected parts of a label map: the id, a box around it, and the part inside."""
    ids, dense = labels.unique(return_inverse=True)
    for id, box in zip(ids.tolist(), find_objects(dense.numpy() + 1), strict=True):
        if id == BACKGROUND:
            continue
        mask = (labels[box] == id).numpy().astype(np.uint8)
        count, parts, stats, _ = cv2.connectedComponentsWithStats(mask)
        for part in range(1, count):
            x, y, width, height, _ = stats[part].tolist()
            top, left = box[0].start + y, box[1].start + x
            around = (slice(top, top + height), slice(left, left + width))
            yield id, around, torch.from_numpy(parts[y : y + height, x : x + width] == part)


def map_labels(labels: Labels, ids: Mapping[int, int]) -> Labels:
    """A label map with other ids."""
    found, where = labels.unique(return_inverse=True)
    return torch.tensor([ids[id] for id in found.tolist()], dtype=labels.dtype)[where]


def cluster_parts(
    parts: csr_array, roots: Float[np.ndarray, "V N"], view_of: Int[np.ndarray, " P"]
) -> Int[np.ndarray, " P"]:
    """Groups of parts: the two with the greatest IoU united, until none have enough.

    The IoU of two groups is at most the greatest of a part of one with a part of the other. So only
    parts that chains of enough IoU join can become one group, and tables of every two are made for
    these alone: for all of 20,000 parts they would take 3 GB.

    Args:
        parts: Pixels of every Gaussian in a part, over the root of its pixels in the part's view,
            [P, N].
        roots: These roots.
        view_of: The view of every part.

    Returns:
        The group of every part, from 0.
    """
    visible = np.asarray(parts @ roots.T)  # [P, V]
    group = np.arange(len(view_of))
    chains = [chain for chain in _chains(parts, visible, view_of) if len(chain) > 1]
    with task("same objects", sum(map(len, chains)), unit="part") as bar:
        for chain in chains:
            tables = [_overlaps(parts, visible, view_of, some, chain) for some in _blocks(chain)]
            intersections, unions = map(np.concatenate, zip(*tables, strict=True))
            group[chain] = chain[_merge(intersections, unions)]
            bar.advance(len(chain))
    return np.unique(group, return_inverse=True)[1]


def _chains(
    parts: csr_array, visible: Float[np.ndarray, "P V"], view_of: Int[np.ndarray, " P"]
) -> list[Int[np.ndarray, " C"]]:
    """The connected components of parts of which two have enough IoU."""
    every, pairs = np.arange(len(view_of)), [np.zeros((2, 0), int)]
    for some in track(_blocks(every), "comparing parts", unit="block"):
        later = every[some[0] :]
        iou = _iou(*_overlaps(parts, visible, view_of, some, later))
        one, other = np.nonzero(iou >= REPAIR_SAME_IOU)
        pairs.append(np.stack([some[one], later[other]]))
    places = np.concatenate(pairs, axis=1)
    joined = csr_array((np.ones(places.shape[1], bool), places), shape=(len(every), len(every)))
    component = connected_components(joined, directed=False)[1]
    return np.split(component.argsort(kind="stable"), np.bincount(component).cumsum()[:-1])


def _blocks(rows: Int[np.ndarray, " C"]) -> list[Int[np.ndarray, " _"]]:
    return np.split(rows, range(REPAIR_BLOCK, len(rows), REPAIR_BLOCK))


def _overlaps(
    parts: csr_array,
    visible: Float[np.ndarray, "P V"],
    view_of: Int[np.ndarray, " P"],
    some: Int[np.ndarray, " A"],
    others: Int[np.ndarray, " B"],
) -> tuple[Float[np.ndarray, "A B"], Float[np.ndarray, "A B"]]:
    """Intersections and unions of parts, in what both their views see, or 0.

    `visible` are the pixels of a part that each view sees. 0 says that both views see too little.
    """
    mine, theirs = visible[some][:, view_of[others]], visible[others][:, view_of[some]].T
    whole = visible[some, view_of[some]][:, None], visible[others, view_of[others]]
    enough = np.minimum(mine, theirs) >= COMMON_SIGHT * np.minimum(*whole)
    shared = (parts[some] @ csr_array(parts[others].T)).toarray()
    return np.where(enough, shared, 0), np.where(enough, mine + theirs - shared, 0)


def _iou(
    intersections: Float[np.ndarray, "*S"], unions: Float[np.ndarray, "*S"]
) -> Float[np.ndarray, "*S"]:
    return intersections / np.maximum(unions, 1e-9)


def _merge(
    intersections: Float[np.ndarray, "C C"], unions: Float[np.ndarray, "C C"]
) -> Int[np.ndarray, " C"]:
    """One part of its group for every part; see `cluster_parts`. The tables are overwritten."""
    group = np.arange(len(intersections))
    np.fill_diagonal(intersections, 0)
    best, most = np.zeros(len(group), int), np.zeros(len(group), intersections.dtype)
    stale = group
    while True:
        for row in stale:
            iou = _iou(intersections[row], unions[row])
            best[row] = iou.argmax()
            most[row] = iou[best[row]]
        one = int(most.argmax())
        other = int(best[one])
        if most[one] < REPAIR_SAME_IOU:
            return group
        group[group == other] = one
        for table in (intersections, unions):
            table[one] += table[other]
            table[one, one] = 0
            table[:, one] = table[one]
            table[other] = table[:, other] = 0
        best[other], most[other] = -1, 0
        stale = np.union1d(np.flatnonzero((best == one) | (best == other)), [one])
        iou = _iou(intersections[one], unions[one])
        best[iou > most], most = one, np.maximum(most, iou)


def _number_parts(labels: Labels, first: int) -> tuple[Labels, dict[int, int]]:
    """Every connected part of a label map under a number of its own, and its id by number."""
    ids = dict[int, int]()
    numbers = torch.zeros(labels.shape, dtype=torch.int32)  # half of what int64 takes
    for id, box, part in connected_parts(labels):
        if part.sum() >= SMALLEST_PART * labels.numel():
            number = first + len(ids)
            numbers[box][part] = number
            ids[number] = id
    return numbers, ids


def _unite_by_id(
    groups: Int[np.ndarray, " P"], view_of: Int[np.ndarray, " P"], id_of: Int[np.ndarray, " P"]
) -> Int[np.ndarray, " P"]:
    """Groups united that have one id in most of the photos that show both, as things behind bars.

    What matters is that ids are the same in one photo, not from photo to photo.
    """

    def count_together(rows: Int[np.ndarray, " P"]) -> csr_array:
        """In how many rows two groups occur together, [G, G]."""
        occurs = csr_array((np.ones(len(rows), int), (rows, groups)))  # sums what occurs twice
        occurs.data[:] = 1
        return csr_array(occurs.T @ occurs)

    masks = np.unique(np.stack([view_of, id_of]), axis=1, return_inverse=True)[1]
    together = count_together(masks)
    often = csr_array(together >= REPAIR_MIN_PHOTOS)
    same = often.multiply(2 * together > count_together(view_of))
    return connected_components(same)[1][groups]


def _vote(splats: Splats, cameras: Cameras, maps: list[OwnLabels]) -> bool:
    """Give parts, in place, the ids that all other views vote for; whether any changed."""
    counted = track(maps, "votes for ids", unit="photo")
    votes = [_gaussian_pixels(splats, cameras[row], labels) for row, labels in enumerate(counted)]
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
        winner, certainty = _render_votes(splats, cameras[row], others, mine.sum(axis=1) > 0)
        voted = _apply_votes(maps[row], ids[winner].to(maps[row]), certainty)
        changed |= not torch.equal(voted, maps[row])
        maps[row] = voted
    return changed


def _render_votes(
    splats: Splats, camera: Cameras, votes: csr_array, visible: Bool[np.ndarray, " N"]
) -> tuple[Int[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The column that most Gaussians in a pixel vote for, background first, and their share."""
    votes.data[votes.indices == 0] *= BACKGROUND_WEIGHT
    rows = np.arange(len(splats) + 1)
    prior = np.full(len(splats), PRIOR, np.float32), 0 * rows[1:], rows
    votes = votes + csr_array(prior, shape=votes.shape)
    shares = csr_array(votes.multiply(1 / votes.sum(axis=1)[:, None]))
    counts = np.diff(shares.indptr)
    largest = shares.data == np.repeat(shares.max(axis=1).toarray(), counts)
    firsts = np.unique(shares.indices[largest & np.repeat(visible, counts)])
    columns = np.union1d([0], firsts)  # others win nowhere: less to render
    certainty, best = render_argmax(splats, camera.at_most(REPAIR_SIDE), shares[:, columns])
    width, height = camera.size
    winner = resize_labels(torch.from_numpy(columns)[best], (height, width))
    return winner, resize_labels(certainty, (height, width))


def _apply_votes(labels: Labels, winner: Labels, certainty: Float[Tensor, "H W"]) -> Labels:
    """A label map whose parts take the labels that won there, and the objects that it lacks."""
    voted, pixels = labels.clone(), labels.numel()
    areas = _areas(winner)
    for _, box, part in connected_parts(labels):
        counts = _areas(winner[box][part])
        counts.pop(BACKGROUND, None)
        total = sum(counts.values())
        if 2 * total < part.sum():
            continue  # the other views know no better
        large = [
            id
            for id, count in counts.items()
            if count >= SECOND_OBJECT * total
            or count >= max(WHOLE_OBJECT * areas[id], SMALLEST_PART * pixels)
        ]
        if len(large) > 1:
            known = part & torch.isin(winner[box], torch.tensor(large))
            voted[box][part] = _fill_nearest(winner[box], known)[part]
        else:
            voted[box][part] = max(counts, key=lambda id: counts[id])
    for id in areas:
        there = (winner == id) & (certainty > 0.5)
        known, area = (there & (voted == id)).sum(), there.sum()
        is_large = id != BACKGROUND and area >= SMALLEST_PART * pixels
        if is_large and known < REPAIR_LOST * area:
            voted[there & (voted == BACKGROUND)] = id
    return voted


def _areas(labels: Int[Tensor, "..."]) -> dict[int, int]:
    ids, counts = labels.unique(return_counts=True)
    return dict(zip(ids.tolist(), counts.tolist(), strict=True))


def _fill_nearest(labels: Labels, known: Bool[Tensor, "H W"]) -> Labels:
    """Where labels are not known, those of the nearest pixel where they are."""
    nearest = distance_transform_edt(~known.numpy(), return_distances=False, return_indices=True)
    assert nearest is not None  # so typed for calls that fill an array
    y, x = torch.from_numpy(nearest).long()
    return labels[y, x]


def _renumber(maps: Sequence[OwnLabels]) -> list[OwnLabels]:
    """Ids from 1, by size; what is tiny in all views but one becomes background."""
    sizes, shares = dict[int, int](), dict[int, list[float]]()
    for labels in maps:
        for id, count in _areas(labels).items():
            sizes[id] = sizes.get(id, 0) + count
            shares.setdefault(id, []).append(count / labels.numel())
    views = min(2, len(maps))
    seen = {id: sum(share >= SMALLEST_PART for share in each) for id, each in shares.items()}
    objects = [id for id in sizes if id != BACKGROUND and seen[id] >= views]
    order = sorted(objects, key=lambda id: -sizes[id])
    new = dict.fromkeys(sizes, BACKGROUND) | {id: n for n, id in enumerate(order, start=1)}
    return [map_labels(labels, new) for labels in maps]

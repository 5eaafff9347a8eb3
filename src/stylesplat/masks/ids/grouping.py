"""Which parts of label maps are the same object: those that show the same Gaussians."""

from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import find_objects
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from stylesplat.progress import task, track
from stylesplat.rendering.shares import label_votes
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND, Labels, OwnLabels, resize_labels
from stylesplat.scene.splats import Splats

SIDE = 640  # pixels of a photo's longer side that are enough to tell what it shows
SAME = 0.3  # IoU of two groups of parts, in what both sides see, from which they are one
SIGHT = 0.2  # of the smaller part, that both views must see before their IoU says anything
SMALL = 5e-4  # of a photo: a part that is smaller is dropped
PHOTOS = 3  # in which groups of parts must have had the same id, for that to be no accident
FAINT = 1e-2  # pixels of a Gaussian in a part that do not matter

Window = tuple[slice, slice]


def group_parts(splats: Splats, cameras: Cameras, maps: Sequence[OwnLabels]) -> list[OwnLabels]:
    """Label maps whose ids are groups of connected parts that show the same Gaussians.

    Args:
        splats: A scene of the views.
        cameras: One per label map, of its size.
        maps: Of any ids, which mean nothing from one to the next.
    """
    numbered, rows, seen, view_of, id_of = [], [], [], [], []
    for row, labels in enumerate(track(maps, "what parts show", unit="photo")):
        parts, own_ids = _numbered(labels, first=len(view_of) + 1)
        ids, pixels = pixels_of(splats, cameras[row], parts)
        root = np.sqrt(pixels.sum(axis=1))
        own = pixels[:, [ids.index(part) for part in own_ids]]
        rows.append(csr_array(own.multiply(1 / np.maximum(root, 1e-6)[:, None]).T))
        seen.append(root)
        view_of += [row] * len(own_ids)
        id_of += own_ids.values()
        numbered.append(parts)
    if not view_of:
        return numbered
    views = np.array(view_of)
    group = clusters(*_overlaps(csr_array(vstack(rows)), np.stack(seen), views))
    group = _under_one_id(group, views, np.array(id_of))
    ids = {BACKGROUND: BACKGROUND} | {part: int(k) + 1 for part, k in enumerate(group, start=1)}
    return [mapped(parts, ids) for parts in numbered]


def pixels_of(splats: Splats, camera: Cameras, labels: Labels) -> tuple[tuple[int, ...], csr_array]:
    """The ids of a label map, background first, and their pixels of every Gaussian, [N, K]."""
    small = at_work(camera)
    width, height = small.size
    ids, votes = label_votes(splats, small, [(0, resize_labels(labels, (height, width)))])
    pixels = csr_array(votes * (labels.numel() / (width * height)))
    pixels.data[pixels.data <= FAINT] = 0
    pixels.eliminate_zeros()
    return ids, pixels


def at_work(camera: Cameras) -> Cameras:
    """A camera of a size that is enough to tell what it shows."""
    return camera.at_most(SIDE)


def parts_of(labels: Labels) -> Iterator[tuple[int, Window, Bool[Tensor, "h w"]]]:
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


def mapped(labels: Labels, ids: Mapping[int, int]) -> Labels:
    """A label map with other ids."""
    found, where = labels.unique(return_inverse=True)
    return torch.tensor([ids[id] for id in found.tolist()], dtype=labels.dtype)[where]


def clusters(
    both: Float[np.ndarray, "P P"], either: Float[np.ndarray, "P P"]
) -> Int[np.ndarray, " P"]:
    """Groups of parts: the two with the greatest IoU united, until none have enough.

    Args:
        both: Intersections of every two parts; used up, so that there is no third such table.
        either: Their unions; used up as well.
    """
    group = np.arange(len(both))
    np.fill_diagonal(both, 0)
    best, most = np.zeros(len(both), int), np.zeros(len(both), both.dtype)
    stale = group
    with task("same objects", len(both), unit="part") as bar:
        while True:
            for row in stale:
                iou = both[row] / np.maximum(either[row], 1e-9)
                best[row] = iou.argmax()
                most[row] = iou[best[row]]
            one = int(most.argmax())
            other = int(best[one])
            if most[one] < SAME:
                return np.unique(group, return_inverse=True)[1]
            group[group == other] = one
            for table in (both, either):
                table[one] += table[other]
                table[one, one] = 0
                table[:, one] = table[one]
                table[other] = table[:, other] = 0
            best[other], most[other] = -1, 0
            stale = np.union1d(np.flatnonzero((best == one) | (best == other)), [one])
            iou = both[one] / np.maximum(either[one], 1e-9)
            best[iou > most], most = one, np.maximum(most, iou)
            bar.advance()


def _numbered(labels: Labels, first: int) -> tuple[Labels, dict[int, int]]:
    """Every connected part of a label map under a number of its own, and the ids of these.

    Tiny parts are dropped.
    """
    ids = dict[int, int]()
    numbers = torch.zeros(labels.shape, dtype=torch.int32)  # half of what int64 takes
    for id, box, part in parts_of(labels):
        if part.sum() >= SMALL * labels.numel():
            number = first + len(ids)
            numbers[box][part] = number
            ids[number] = id
    return numbers, ids


def _overlaps(
    parts: csr_array, seen: Float[np.ndarray, "V N"], view_of: Int[np.ndarray, " P"]
) -> tuple[Float[np.ndarray, "P P"], Float[np.ndarray, "P P"]]:
    """Intersection and union of every two parts, in what both their views see.

    Both are 0 where that is too little to say anything.

    Args:
        parts: What a part shows of every Gaussian: pixels, over the root of `seen` squared.
        seen: Root of the pixels that a view shows of every Gaussian.
        view_of: The view of every part.
    """
    visible = np.asarray(parts @ seen.T)  # [P, V]
    whole = visible[np.arange(len(view_of)), view_of]
    gaussians = csr_array(parts.T)
    both, either = np.zeros((2, len(whole), len(whole)), np.float32)
    for view in track(range(len(seen)), "comparing parts", unit="photo"):
        rows = view_of == view
        mine, theirs = visible[rows][:, view_of], visible[:, view].T
        enough = np.minimum(mine, theirs) >= SIGHT * np.minimum(whole[rows][:, None], whole)
        shared = (parts[rows] @ gaussians).toarray()
        both[rows] = np.where(enough, shared, 0)
        either[rows] = np.where(enough, mine + theirs - shared, 0)
    return both, either


def _under_one_id(
    group: Int[np.ndarray, " P"], view_of: Int[np.ndarray, " P"], id_of: Int[np.ndarray, " P"]
) -> Int[np.ndarray, " P"]:
    """Groups united that have one id in most of the photos that show both, as things behind bars.

    What matters is that ids are the same in one photo, not from photo to photo.
    """
    masks = np.unique(np.stack([view_of, id_of]), axis=1, return_inverse=True)[1]
    together, met = (
        (held.T @ held).toarray()
        for held in (_membership(masks, group), _membership(view_of, group))
    )
    same = (together >= PHOTOS) & (together > met / 2)
    return connected_components(same)[1][group]


def _membership(rows: Int[np.ndarray, " P"], columns: Int[np.ndarray, " P"]) -> csr_array:
    """1 where a row and a column meet in any part."""
    met = np.zeros((rows.max() + 1, columns.max() + 1), bool)
    met[rows, columns] = True
    return csr_array(met.astype(int))

"""Which masks are the same object: within a photo, among neighbours, and over time.

The decoupled scheme of DEVA (Cheng et al. 2023): what a segmenter finds in single photos is a
hypothesis; neighbouring photos confirm it; what is confirmed takes on the ids that are known.
"""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from stylesplat.metrics.iou import pairwise_iou
from stylesplat.scene.labels import BACKGROUND, Labels, Mask

SAME = 0.5  # IoU of two masks of one object in one photo
FREE = 0.5  # of a mask, that no better one may cover already
LARGEST = 0.5  # of a photo: what is larger is background
SMALLEST = 5e-4  # of a photo: what is smaller is a fragment
CONFIRMED = 2  # photos that must agree on an object


def apart(masks: Sequence[Mask]) -> list[Mask]:
    """Masks that do not overlap: whole objects rather than their parts, nothing tiny or vast."""
    if not masks:
        return []
    pixels = masks[0].numel()
    fit = [mask for mask in masks if mask.sum() <= LARGEST * pixels]
    return _free_of_better(sorted(fit, key=lambda mask: -int(mask.sum())))


def confirmed(views: Sequence[Sequence[Mask]]) -> list[Mask]:
    """The masks of one photo that its neighbours confirm; where only they have one, theirs.

    Args:
        views: What was found in the photo; then what was found in each neighbour, followed into
            the photo. If there is no neighbour, all is taken for confirmed.

    Returns:
        Masks that do not overlap, those first that most photos agree on.
    """
    pool = [(view, mask) for view, masks in enumerate(views) for mask in masks]
    if not pool:
        return []
    same = _ious([mask for _, mask in pool], [mask for _, mask in pool]) >= SAME
    origin = torch.tensor([view for view, _ in pool])
    support = [len(origin[row].unique()) for row in same]
    enough = min(CONFIRMED, len(views))
    order = sorted(
        range(len(pool)), key=lambda i: (-support[i], pool[i][0], -int(pool[i][1].sum()))
    )
    return _free_of_better([pool[i][1] for i in order if support[i] >= enough])


def associate(
    known: Mapping[int, Mask], found: Sequence[Mask], next_id: int
) -> tuple[dict[int, Mask], set[int]]:
    """Give masks of a photo the ids of those that were followed there.

    Args:
        known: Masks by id, followed from earlier photos.
        found: Masks that do not overlap.
        next_id: The first id for objects that are new.

    Returns:
        Masks by id that do not overlap: the found ones with the ids of known ones, known ones that
        were not found again, and new ones where nothing is known; and the ids that were found.
    """
    ids = [*known]
    ious = _ious([*known.values()], found)
    pairs = zip(*linear_sum_assignment(ious.numpy(), maximize=True), strict=True)
    matches = {ids[i]: int(j) for i, j in pairs if ious[i, j] >= SAME}
    result = {}
    for id, mask in known.items():
        if id in matches:
            # A mask of two objects must not swallow the other
            others = [other for each, other in known.items() if each != id]
            mask = found[matches[id]] & ~_union(others, like=mask)
        result[id] = mask
    fresh = [mask for j, mask in enumerate(found) if j not in matches.values()]
    # Nor is what is left of a known object, where less of it was found, another
    taken = [*known.values(), *result.values()]
    for mask in _free_of_better(fresh, taken=_union(taken, like=fresh[0]) if fresh else None):
        result[next_id] = mask
        next_id += 1
    return result, {*matches, *(id for id in result if id not in known)}


def to_labels(masks: Mapping[int, Mask], size: Sequence[int]) -> Labels:
    """A label map of masks that do not overlap."""
    labels = torch.full(tuple(size), BACKGROUND, dtype=torch.int64)
    for id, mask in masks.items():
        labels[mask] = id
    return labels


def to_masks(labels: Labels) -> dict[int, Mask]:
    """The masks of a label map by id, background left out."""
    return {id: labels == id for id in labels.unique().tolist() if id != BACKGROUND}


def _free_of_better(masks: Sequence[Mask], taken: Mask | None = None) -> list[Mask]:
    """Each mask less what is taken, and taken by those before it.

    It is left out if that is most of it, or it is tiny.
    """
    kept = []
    for mask in masks:
        free = mask if taken is None else mask & ~taken
        area, left = int(mask.sum()), int(free.sum())
        if left >= max(SMALLEST * mask.numel(), FREE * area, 1):
            kept.append(free)
            taken = free if taken is None else taken | free
    return kept


def _union(masks: Sequence[Mask], *, like: Mask) -> Mask:
    return torch.stack([*masks, torch.zeros_like(like)]).any(dim=0)


def _ious(some: Sequence[Mask], others: Sequence[Mask]) -> Float[Tensor, "A B"]:
    """IoU of every mask with every other, from every second pixel along x and y."""
    thin_some, thin_others = ([mask[::2, ::2] for mask in masks] for masks in (some, others))
    return pairwise_iou(thin_some, thin_others)

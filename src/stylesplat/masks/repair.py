"""Ids of label maps made to agree in 3D: what shows the same Gaussians is the same object.

A tracker takes one object for another, loses it, or finds it anew under another id. On the
Gaussians of a splat all views meet, and outvote what single ones got wrong.
"""

from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array, vstack
from torch import Tensor
from tqdm import tqdm

from stylesplat.rendering.votes import label_votes, render_shares
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.splats import Splats

ROUNDS = 3  # of votes of Gaussians for parts of label maps, and back
SAME = 0.3  # IoU of two groups of parts, in what both sides see, from which they are one
SIGHT = 0.2  # of the smaller part, that both views must see before their IoU says anything
TWO = 0.25  # of a part of a label map, that must be another object for it to be cut
LOST = 0.3  # of what an object covers in a view, below which the label map has missed it
PRIOR = 0.02  # pixels of background that every Gaussian has seen
SMALL = 5e-4  # of a photo: what is smaller in every one is no object
FAINT = 1e-2  # pixels of a Gaussian in a part that do not matter

Labels = Int[Tensor, "H W"]


@torch.no_grad()
def repair(splats: Splats, cameras: Cameras, maps: Sequence[Labels]) -> list[Labels]:
    """Make the ids of label maps agree over all views.

    Connected parts of label maps are grouped by the Gaussians that they show, whatever ids they
    had: an id that went over to another object is cut, ids of one object become one. Then every
    part takes the group that the Gaussians vote for, as all other views see them; parts that show
    two objects are cut, objects that a view has missed are filled in. Borders stay where they
    were drawn.

    Args:
        splats: A scene of the views; its labels do not matter.
        cameras: One per label map, of its size.
        maps: With ids that may differ from view to view.

    Returns:
        New label maps; ids count from 1, larger objects first.
    """
    maps = _grouped(splats, cameras, maps)
    for _ in range(ROUNDS):
        before, maps = maps, _settled(splats, cameras, maps)
        if all(map(torch.equal, before, maps)):
            break
    return _renumbered(maps)


def _grouped(splats: Splats, cameras: Cameras, maps: Sequence[Labels]) -> list[Labels]:
    """Label maps whose ids are groups of parts that show the same Gaussians."""
    numbered, rows, seen, view_of = [], [], [], []
    for row, labels in enumerate(tqdm(maps, desc="what parts show", unit="photo")):
        parts = _numbered(labels, first=len(view_of) + 1)
        ids, votes = label_votes(splats, cameras, [(row, parts)])
        pixels = votes.cpu().numpy()
        root = np.sqrt(pixels.sum(axis=1))
        own = pixels[:, [k for k, id in enumerate(ids) if id != BACKGROUND]]
        rows.append(csr_array((np.where(own > FAINT, own, 0) / np.maximum(root, 1e-6)[:, None]).T))
        seen.append(root)
        view_of += [row] * own.shape[1]
        numbered.append(parts)
    if not view_of:
        return list(maps)
    group = _clusters(*_overlaps(csr_array(vstack(rows)), np.stack(seen), np.array(view_of)))
    ids = {BACKGROUND: BACKGROUND} | {part: int(k) + 1 for part, k in enumerate(group, start=1)}
    return [_mapped(parts, ids) for parts in numbered]


def _numbered(labels: Labels, first: int) -> Labels:
    """Every connected part of a label map under a number of its own; tiny ones are dropped."""
    numbers = torch.zeros_like(labels)
    for id in labels.unique().tolist():
        for part in _parts(labels == id) if id != BACKGROUND else ():
            if part.sum() >= SMALL * part.numel():
                numbers[part] = first
                first += 1
    return numbers


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
    both = (parts @ parts.T).toarray()
    visible = np.asarray(parts @ seen.T)[:, view_of]  # [P, P]: of the row's, in the column's view
    whole = visible.diagonal()
    enough = np.minimum(visible, visible.T) >= SIGHT * np.minimum(whole[:, None], whole)
    either = visible + visible.T - both
    return np.where(enough, both, 0), np.where(enough, either, 0)


def _clusters(
    both: Float[np.ndarray, "P P"], either: Float[np.ndarray, "P P"]
) -> Int[np.ndarray, " P"]:
    """Groups of parts: the two with the greatest IoU united, until none have enough."""
    both, either = both.copy(), either.copy()
    np.fill_diagonal(both, 0)
    group = np.arange(len(both))
    while True:
        iou = both / np.maximum(either, 1e-9)
        one, other = divmod(int(iou.argmax()), len(iou))
        if iou[one, other] < SAME:
            return np.unique(group, return_inverse=True)[1]
        for table in (both, either):
            table[one] += table[other]
            table[:, one] += table[:, other]
            table[other] = table[:, other] = 0
        both[one, one] = 0
        group[group == other] = one


def _settled(splats: Splats, cameras: Cameras, maps: Sequence[Labels]) -> list[Labels]:
    """Every part of a label map takes the id that all other views vote for."""
    ids, votes = label_votes(splats, cameras, enumerate(maps))
    known = torch.tensor(ids)
    settled = []
    for row, labels in enumerate(tqdm(maps, desc="checking ids in 3D", unit="photo")):
        own_ids, own = label_votes(splats, cameras, [(row, labels)])
        others = votes.clone()
        others[:, [ids.index(id) for id in own_ids]] -= own
        others = others.clamp(min=0)
        others[:, ids.index(BACKGROUND)] += PRIOR
        shares = others / others.sum(dim=1, keepdim=True)
        shown = render_shares(splats, cameras[row], shares).cpu()
        certainty, column = shown.max(dim=-1)
        settled.append(_voted(labels, known[column], certainty))
    return settled


def _voted(labels: Labels, shown: Labels, certainty: Float[Tensor, "H W"]) -> Labels:
    """A label map whose parts take the labels that show there, and the objects that it lacks."""
    voted = labels.clone()
    for id in labels.unique().tolist():
        if id == BACKGROUND:
            continue
        for part in _parts(labels == id):
            here, counts = shown[part].unique(return_counts=True)
            objects = here != BACKGROUND
            here, counts = here[objects], counts[objects]
            if 2 * int(counts.sum()) < int(part.sum()):
                continue  # the views know no better
            large = here[counts >= TWO * counts.sum()]
            if len(large) > 1:
                cut = part & torch.isin(shown, large)
                voted[cut] = shown[cut]
            else:
                voted[part] = here[counts.argmax()]
    for id in shown.unique().tolist():
        there = (shown == id) & (certainty > 0.5)
        missing = there & (voted == BACKGROUND)
        enough = there.sum() >= SMALL * there.numel()
        if id != BACKGROUND and enough and (voted == id).sum() < LOST * there.sum():
            voted[missing] = id
    return voted


def _parts(mask: Bool[Tensor, "H W"]) -> Iterator[Bool[Tensor, "H W"]]:
    """The connected parts of a mask."""
    count, parts = cv2.connectedComponents(mask.numpy().astype(np.uint8))
    for part in range(1, count):
        yield torch.from_numpy(parts == part)


def _renumbered(maps: list[Labels]) -> list[Labels]:
    """Ids from 1, by size; what is tiny wherever it shows becomes background."""
    sizes, largest = dict[int, int](), dict[int, float]()
    for labels in maps:
        for id, count in zip(
            *(each.tolist() for each in labels.unique(return_counts=True)), strict=True
        ):
            sizes[id] = sizes.get(id, 0) + count
            largest[id] = max(largest.get(id, 0.0), count / labels.numel())
    objects = [id for id in sizes if id != BACKGROUND and largest[id] >= SMALL]
    order = sorted(objects, key=lambda id: -sizes[id])
    new = dict.fromkeys(sizes, BACKGROUND) | {id: n for n, id in enumerate(order, start=1)}
    return [_mapped(labels, new) for labels in maps]


def _mapped(labels: Labels, ids: Mapping[int, int]) -> Labels:
    found, where = labels.unique(return_inverse=True)
    return torch.tensor([ids[id] for id in found.tolist()])[where]

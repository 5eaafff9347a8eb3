"""Label maps of a whole capture from a segmenter that knows single photos and their neighbours."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from scipy.spatial.distance import cdist

from stylesplat.masks.models.associate import apart, associate, confirmed, to_labels, to_masks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import Labels, Mask

STRETCH = 5  # photos from one key photo, where objects are looked for, to the next
WINDOW = 3  # photos that vote on what a key photo shows: itself and those after it
FAR = 10.0  # for photos of another size to come last: the cameras' mean distance is 1
PATIENCE = 3  # key photos in a row in which an object may be missed before it is given up


@dataclass(frozen=True)
class Segmenter:
    """What finds objects in photos, which it knows by their rows."""

    size: Callable[[int], tuple[int, int]]
    """Height and width of a photo."""
    propose: Callable[[int], Sequence[Mask]]
    """Masks of what may be objects in a photo; they may overlap."""
    follow: Callable[[Sequence[int], Mapping[int, Mask]], Sequence[Mapping[int, Mask]]]
    """From masks by id in the first photo to those in all of some photos, which are neighbours."""


@dataclass(frozen=True)
class State:
    """What is known between two stretches of photos."""

    known: Labels | None = None
    """Objects that were followed into the next key photo; no use if that is of another size."""
    missed: dict[int, int] = field(default_factory=dict)
    """In how many key photos in a row an object was not found again."""
    next_id: int = 1


def stretches(cameras: Cameras) -> list[list[int]]:
    """Rows of photos in the order of the camera's path, cut at key photos.

    Each stretch but the last ends with the key photo that the next one begins with, unless the
    photos' size changes there.
    """
    order, sizes = camera_path(cameras), cameras.sizes.tolist()
    parts, part = [], [order[0]]
    for row in order[1:]:
        same_size = sizes[row] == sizes[part[0]]
        if same_size:
            part.append(row)
        if not same_size or len(part) == STRETCH + 1:
            parts.append(part)
            part = [row]
    parts.append(part)
    # A key photo alone, which the stretch before has labelled, is no stretch
    return [part for k, part in enumerate(parts) if k == 0 or part != parts[k - 1][-1:]]


def camera_path(cameras: Cameras) -> list[int]:
    """Rows in an order in which neighbours see much the same.

    That of the files, as in a video, unless going to the nearest camera each time is shorter. To
    a photo of another size it is far.
    """
    positions = cameras.positions.cpu().numpy()
    forward = cameras.viewmats[:, 2, :3].cpu().numpy()
    size = max(float(cdist(positions, positions.mean(axis=0)[None]).mean()), 1e-9)
    sizes = cameras.sizes.numpy()
    steps = torch.from_numpy(
        cdist(positions, positions) / size
        + cdist(forward, forward)
        + (cdist(sizes, sizes) > 0) * FAR
    )
    as_named = [*range(len(cameras))]
    greedy, left = [0], set(as_named[1:])
    while left:
        nearest = min(left, key=lambda row: float(steps[greedy[-1], row]))
        greedy.append(nearest)
        left.remove(nearest)
    return min(as_named, greedy, key=lambda order: float(steps[order[:-1], order[1:]].sum()))


def track(
    rows: Sequence[int], state: State, segmenter: Segmenter
) -> tuple[dict[int, Labels], State]:
    """Label one stretch of photos.

    Objects are looked for in the key photo, the first, and followed through the others. What is
    found must be confirmed by the photos after it.

    Args:
        rows: Of photos of one size, along the camera's path.
        state: After the stretch before; a new one to begin with.
        segmenter: Finds and follows objects.

    Returns:
        The label maps by row, and the state for the stretch that begins with the last row.
    """
    views = list(_hypotheses(rows[:WINDOW], segmenter))
    size = segmenter.size(rows[0])
    same_size = state.known is not None and state.known.shape == size
    known = to_masks(state.known) if state.known is not None and same_size else {}
    masks, seen = associate(known, confirmed(views), state.next_id)
    next_id = max([state.next_id - 1, *masks]) + 1
    missed = {id: 0 if id in seen else state.missed.get(id, 0) + 1 for id in masks}
    masks = {id: mask for id, mask in masks.items() if missed[id] < PATIENCE}
    followed = segmenter.follow(rows, masks) if masks else [{} for _ in rows]
    maps = {row: to_labels(each, size) for row, each in zip(rows, followed, strict=True)}
    return maps, State(maps[rows[-1]], {id: missed[id] for id in masks}, next_id)


def _hypotheses(rows: Sequence[int], segmenter: Segmenter) -> Iterator[list[Mask]]:
    """What each photo shows, as it looks in the first of them."""
    yield apart(segmenter.propose(rows[0]))
    for row in rows[1:]:
        found = dict(enumerate(apart(segmenter.propose(row)), start=1))
        yield [*segmenter.follow([row, rows[0]], found)[-1].values()] if found else []

"""What masks from several sides leave of space, and its outlines.

Masks that hold an object and more (its shadow, what moves elsewhere) become its silhouettes: only
the object is inside of most of them. After Laurentini: The Visual Hull Concept, 1994.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras, focus_point
from stylesplat.scene.projection import project

HULL_CELLS, HULL_LEVELS = (
    48,
    3,
)  # cells along each side at first; sizes of cells, each half the last
HULL_SHARE = 0.9  # of the masks: some have holes, and a shadow falls on one place in fewer
HULL_PART = 0.02  # of the largest part of a mask: smaller ones are noise
HULL_SEEN = 0.5  # share of the photos that have to show a place


def silhouettes(
    masks: Sequence[Bool[Tensor, "H W"]], cameras: Cameras
) -> list[Bool[Tensor, "H W"]]:
    """The parts of masks that show what is inside of most of them.

    Args:
        masks: One for each camera, of its size; each holds the object.
        cameras: They stand around it and look at it.
    """
    cells, size = _carve(masks, cameras)
    outlines = (_outline(cells, size, cameras[row]) for row in range(len(cameras)))
    return [_large_parts(mask & each) for mask, each in zip(masks, outlines, strict=True)]


def _carve(
    masks: Sequence[Bool[Tensor, "H W"]], cameras: Cameras
) -> tuple[Float[Tensor, "N 3"], float]:
    """The middles of the cells that are left, and how long their sides are."""
    middle, reach = _extent(masks, cameras)
    steps = (torch.arange(HULL_CELLS) + 0.5) / HULL_CELLS * 2 - 1
    cells = middle + reach * torch.cartesian_prod(steps, steps, steps)
    size = 2 * reach / HULL_CELLS
    for level in track(range(HULL_LEVELS), "finding outlines"):
        is_last = level == HULL_LEVELS - 1
        seen, inside = (torch.zeros(len(cells)) for _ in range(2))
        for row, mask in enumerate(masks):
            camera = cameras[row]
            if not is_last:  # a cell counts if any of it may be inside
                mask = _dilated(mask, _pixels(size, camera, middle))
            places, shown = _places(cells, camera)
            x, y = places[shown].T
            seen[shown] += 1
            inside[shown] += mask[y, x].float()
        cells = cells[(seen >= HULL_SEEN * len(masks)) & (inside >= HULL_SHARE * seen)]
        if not is_last:
            corners = size / 4 * torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
            cells, size = (cells[:, None] + corners).flatten(0, 1), size / 2
    return cells, size


def _extent(
    masks: Sequence[Bool[Tensor, "H W"]], cameras: Cameras
) -> tuple[Float[Tensor, "3"], float]:
    """Where the cameras look, and how far from there the masks reach in any of them."""
    middle = focus_point(cameras).float()
    farthest = 0.0
    for row, mask in enumerate(masks):
        camera = cameras[row]
        place, depth = (each[0] for each in project(middle[None], camera))
        if mask.any() and depth > 0:
            away = (mask.nonzero().flip(1) + 0.5 - place).norm(dim=1)
            angle = float(np.quantile(away.numpy(), 0.99)) / float(camera.Ks[0, 0, 0])
            farthest = max(farthest, min(1.0, angle) * float(depth))
    return middle, farthest


def _places(
    points: Float[Tensor, "N 3"], camera: Cameras
) -> tuple[Int[Tensor, "N 2"], Bool[Tensor, " N"]]:
    """The pixels that show points, and whether the camera does."""
    places, depths = project(points, camera)
    size = torch.tensor(camera.size)
    shown = ((places >= 0) & (places < size)).all(dim=1) & (depths > 0)
    return places.nan_to_num().clamp(-1, max(camera.size)).long(), shown


def _pixels(size: float, camera: Cameras, place: Float[Tensor, "3"]) -> int:
    """How many pixels wide something is at a place, rounded up."""
    distance = float((camera.positions[0] - place).norm())
    return int(np.ceil(float(camera.Ks[0, 0, 0]) * size / distance))


def _dilated(mask: Bool[Tensor, "H W"], width: int) -> Bool[Tensor, "H W"]:
    kernel = np.ones((2 * width + 1, 2 * width + 1), np.uint8)
    return torch.from_numpy(cv2.dilate(mask.numpy().astype(np.uint8), kernel) > 0)


def _outline(cells: Float[Tensor, "N 3"], size: float, camera: Cameras) -> Bool[Tensor, "H W"]:
    width, height = camera.size
    picture = torch.zeros(height, width, dtype=torch.bool)
    if len(cells):
        places, shown = _places(cells, camera)
        x, y = places[shown].T
        picture[y, x] = True
    # cells lie apart in the picture; what is outside of the mask is left out by it
    return _dilated(picture, _pixels(size, camera, cells.mean(dim=0)) if len(cells) else 0)


def _large_parts(mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    _, parts, figures, _ = cv2.connectedComponentsWithStats(mask.numpy().astype(np.uint8))
    areas = figures[:, cv2.CC_STAT_AREA]
    areas[0] = 0  # what is beside the mask
    return torch.from_numpy((areas > HULL_PART * areas.max())[parts])

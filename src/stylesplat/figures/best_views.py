"""Choose the views that show an object best, and from different sides."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import label
from torch import Tensor
from torch.nn.functional import normalize

from stylesplat.errors import StyleSplatError
from stylesplat.figures.grid import GRID_CELL
from stylesplat.imaging.color import lab_from_rgb
from stylesplat.rendering.render import render
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import COVERED, colors_and_coverage, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import opaque_rows
from stylesplat.scene.projection import share_in_images
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.stylization.views import SURVEY_SIZE

BEST_VIEWS = 3  # of an object
OVERSCAN = 0.5  # of the view on each side, to show what the border of the photo cuts off
PART_SHARE = 0.2  # of the pixels of the largest part: smaller parts are strays
BEST_PADDING = 0.06  # of an object's length, on each side of a picture of it alone
BEST_SURROUNDINGS = 0.15  # of an object, on each side of a close-up
SEARCHED_VIEWS = 12  # that are rendered to find them
BEST_MOST = 0.5  # of the largest share of an object in an image: views with less are not rendered


@dataclass(frozen=True, eq=False)
class ObjectMask:
    """The row of a camera, and an object's pixels in the view that `survey_view` makes of it."""

    row: int
    mask: Bool[Tensor, "h w"]


@torch.no_grad()
def find_views(
    splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"], *, count: int = BEST_VIEWS
) -> list[ObjectMask]:
    """Some views that show most of an object from sides that differ, the best one first."""
    surface = splats.means[opaque_rows(splats, picked)]
    shares = share_in_images(surface, cameras)
    likely = (shares > 0) & (shares >= BEST_MOST * shares.max())  # though it may be hidden there
    rows = evenly_spaced(likely.nonzero()[:, 0].tolist(), SEARCHED_VIEWS)

    def mask(row: int) -> Tensor:
        return coverage(splats, survey_view(cameras[row]), picked) > COVERED

    found = per_view(mask, rows, "looking for the object", splats.device)
    masks = dict(zip(rows, found, strict=True))
    scores = {row: visibility(mask) for row, mask in masks.items()}
    return [ObjectMask(row, masks[row]) for row in best_rows(cameras, surface, scores, count)]


@torch.no_grad()
def most_detailed(splats: Splats, cameras: Cameras, found: Sequence[ObjectMask]) -> ObjectMask:
    """The view that shows most of an object and of its own detail: a face rather than a back."""

    def detail(view: ObjectMask) -> float:
        return shown_detail(render(splats, survey_view(cameras[view.row]))[0], view.mask)

    return max(found, key=detail)


def shown_detail(image: Float[Tensor, "h w 3"], mask: Bool[Tensor, "h w"]) -> float:
    """Visibility, times the mean difference of luminance between neighbouring pixels."""
    luminance = lab_from_rgb(image)[..., 0]
    down = luminance.diff(dim=0)[mask[1:] & mask[:-1]]
    right = luminance.diff(dim=1)[mask[:, 1:] & mask[:, :-1]]
    return visibility(mask) * float(torch.cat([down, right]).abs().mean().nan_to_num())


def best_rows(
    cameras: Cameras,
    surface: Float[Tensor, "M 3"],
    scores: Mapping[int, float],
    count: int = BEST_VIEWS,
) -> list[int]:
    """The cameras that see an object best and from sides that differ, the best one first."""
    rows = [row for row, score in scores.items() if score > 0]
    if not rows:
        return []
    seen = torch.tensor([scores[row] for row in rows])
    away = normalize(cameras[rows].positions.to(surface) - surface.median(dim=0).values, dim=1)
    chosen = [int(seen.argmax())]
    while len(chosen) < min(count, len(rows)):
        apart = torch.cdist(away, away[chosen]).amin(dim=1).cpu()
        gains = (seen * apart).index_fill(0, torch.tensor(chosen), -math.inf)
        chosen.append(int(gains.argmax()))
    return [rows[each] for each in chosen]


def visibility(mask: Bool[Tensor, "h w"]) -> float:
    """Pixels that show an object, fewer if the border cuts it: a quarter for a square."""
    area = float(mask.sum())
    border = sum(float(edge.sum()) for edge in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    return area / (1 + border / math.sqrt(area)) ** 2 if area else 0.0


def survey_view(camera: Cameras) -> Cameras:
    return camera.at_most(SURVEY_SIZE)


@torch.no_grad()
def close_up(
    splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"], *, side: int = GRID_CELL
) -> Cameras:
    """A square view of an object and a margin, from the camera that shows most of its detail."""
    found = find_views(splats, cameras, picked)
    if not found:
        where = cameras.names[0] if len(cameras) == 1 else f"any of {len(cameras)} views"
        raise StyleSplatError(f"The object does not show in {where}. Choose a view of it.")
    best = cameras[most_detailed(splats, cameras, found).row]
    return aim_at(splats, picked, best, side, padding=BEST_SURROUNDINGS)


def aim_at(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    camera: Cameras,
    side: int,
    *,
    padding: float = BEST_PADDING,
) -> Cameras:
    """The same camera, shifted and zoomed to the square around an object, for a picture of it."""
    width, height = camera.size
    step = max(width, height) / SURVEY_SIZE
    left, top = -OVERSCAN * width, -OVERSCAN * height
    wide = (round((1 + 2 * OVERSCAN) * size / step) for size in (width, height))
    survey = camera.crop((left, top), tuple(wide), zoom=1 / step)
    _, share = colors_and_coverage(splats, survey, picked)
    shown = (share[..., 0] > COVERED).cpu().numpy()
    parts = np.empty(shown.shape, np.int32)
    if not label(shown, np.ones((3, 3)), output=parts):
        return camera.crop((0.0, 0.0), (side, side), zoom=side / max(width, height))
    areas = np.bincount(parts.ravel())
    areas[0] = 0  # what does not show
    y, x = np.nonzero((areas >= PART_SHARE * areas.max())[parts])
    x0, y0, x1, y1 = x.min(), y.min(), x.max() + 1, y.max() + 1
    length = max(x1 - x0, y1 - y0) * step * (1 + 2 * padding)
    corner = (left + (x0 + x1) / 2 * step - length / 2, top + (y0 + y1) / 2 * step - length / 2)
    return camera.crop(corner, (side, side), zoom=side / length)

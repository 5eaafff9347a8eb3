"""Which views show an object best, and from sides that differ."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import normalize

from stylesplat.metrics.lab import lab_from_rgb
from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.one_view import render
from stylesplat.rendering.shares import coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import solid
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import MIN_COVERAGE
from stylesplat.selection.in_images import in_images
from stylesplat.stylization.views import SURVEY_SIZE

VIEWS = 3  # of an object
SEARCHED_VIEWS = 12  # rendered to find them, of those that have the object in their image
MOST = 0.5  # of what the fullest image has of an object, from which others are searched too


@dataclass(frozen=True)
class Shown:
    """An object in one view."""

    row: int
    """The camera's."""
    mask: Bool[Tensor, "h w"]
    """The pixels that show it, in the camera that `small` returns."""


@torch.no_grad()
def find_views(
    splats: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
    *,
    count: int = VIEWS,
) -> list[Shown]:
    """The views that show most of an object from sides that differ, the best one first.

    Args:
        splats: The scene.
        cameras: Views to choose from.
        picked: The object's Gaussians.
        count: How many to find; fewer if it shows in fewer.
    """
    surface = splats.means[solid(splats, picked)]

    def mask(row: int) -> Tensor:
        return coverage(splats, small(cameras[row]), picked) > MIN_COVERAGE

    rows = _likely_rows(cameras, surface)
    found = track(at_once(mask, rows, splats.device), "looking for the object", total=len(rows))
    masks = dict(zip(rows, found, strict=True))
    scores = {row: visibility(mask) for row, mask in masks.items()}
    return [Shown(row, masks[row]) for row in best_rows(cameras, surface, scores, count)]


@torch.no_grad()
def most_detailed(splats: Splats, cameras: Cameras, found: Sequence[Shown]) -> Shown:
    """The view that shows most of an object and of its own detail: a face rather than a back.

    Args:
        splats: The scene.
        cameras: Those that the views are rows of.
        found: At least one view of the object.
    """
    return max(found, key=lambda each: _detail(splats, small(cameras[each.row]), each.mask))


def _detail(splats: Splats, camera: Cameras, mask: Bool[Tensor, "h w"]) -> float:
    """How much of an object shows, times its mean difference of luminance between neighbours."""
    luminance = lab_from_rgb(render(splats, camera)[0])[..., 0]
    down = (luminance[1:] - luminance[:-1]).abs()[mask[1:] & mask[:-1]]
    right = (luminance[:, 1:] - luminance[:, :-1]).abs()[mask[:, 1:] & mask[:, :-1]]
    return visibility(mask) * float(torch.cat([down, right]).mean().nan_to_num())


def best_rows(
    cameras: Cameras, surface: Float[Tensor, "M 3"], scores: Mapping[int, float], count: int = VIEWS
) -> list[int]:
    """The cameras that see an object best and from sides that differ, the best one first.

    Args:
        cameras: All there are.
        surface: Points of the object.
        scores: The `visibility` of the object in some of them.
        count: How many to choose; fewer if it shows in fewer.
    """
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


def visibility(shown: Bool[Tensor, "h w"]) -> float:
    """Pixels that show an object, fewer if the border cuts it: of a square cut along a side 1/4."""
    area = float(shown.sum())
    border = sum(float(edge.sum()) for edge in (shown[0], shown[-1], shown[:, 0], shown[:, -1]))
    return area / (1 + border / math.sqrt(area)) ** 2 if area else 0.0


def small(camera: Cameras) -> Cameras:
    """The same camera, for a render in which objects are only looked for."""
    return camera.at_most(SURVEY_SIZE)


def _likely_rows(cameras: Cameras, surface: Float[Tensor, "M 3"]) -> list[int]:
    """Some of the cameras that have an object in their image, though something may hide it."""
    shares = in_images(surface, cameras)
    good = (shares > 0) & (shares >= MOST * shares.max())
    return evenly(good.nonzero()[:, 0].tolist(), SEARCHED_VIEWS)

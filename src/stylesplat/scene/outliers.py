"""Cameras and points that lie far from all others: mistakes of a reconstruction, and lengths
without them.

The model: a scene reaches as far from the middle of its cameras as half of its points, or of its
cameras, do. A photo was taken where it shows something of the scene, however far away that is; a
camera many times as far, in whose picture the points are nowhere or all in one spot, is a mistake.
Middles and reaches are medians, so that mistakes do not move them.
"""

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.errors import count_noun, join_names
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import is_in_image, project

OUTLIER_FEWEST = 3  # cameras: of two, neither is the one that is wrong
FAR_CAMERA = 30.0  # reaches: at this distance the scene is 2 degrees wide
FAR_ALONE = 100.0  # reaches, where no points say what a camera shows
FAR_POINT = 100.0  # reaches: nothing so far away moves from photo to photo, so it has no depth
CELLS = 16  # along each side of a picture: points that are in few of them make one spot
OUTLIER_SHOWN = 10  # cells with points in them, from which on a photo shows something of the scene
EXTENT_SHARE = 0.9  # of the cameras, rounded up, whose distances all count for the extent
EXTENT_REACH = 3.0  # distances of that share: others, as of few overviews, count up to these


@dataclass(frozen=True)
class Outliers:
    """What lies far from all else."""

    photos: dict[str, float] = field(default_factory=dict)
    """How many reaches of the scene the camera is away, by the photo's name."""
    rows: tuple[int, ...] = ()
    """Their rows among all photos."""
    points: int = 0
    """How many of the sparse points."""

    def __bool__(self) -> bool:
        return bool(self.photos or self.points)

    def __str__(self) -> str:
        far = "times as far away as the scene reaches"
        facts = [f"{name} (posed {x:,.0f} {far})" for name, x in self.photos.items()]
        points = count_noun(self.points, "point")
        return join_names(facts + [f"{points} (over {FAR_POINT:.0f} {far})"] * bool(self.points))


def find_outliers(
    cameras: Cameras, points: Float[Tensor, "M 3"] | None
) -> tuple[Bool[Tensor, " C"], Bool[Tensor, " M"] | None, Outliers]:
    """Which cameras and which points are no outliers, and what the others are."""
    near = torch.ones(len(cameras), dtype=torch.bool)
    near_points = None if points is None else torch.ones(len(points), dtype=torch.bool)
    if len(cameras) < OUTLIER_FEWEST:
        return near, near_points, Outliers()
    positions = cameras.positions.double().cpu()
    middle = positions.median(dim=0).values
    away = (positions - middle).norm(dim=1)
    reach, least = float(away.median()), FAR_ALONE
    if points is not None and len(points):
        points_away = (points.double().cpu() - middle).norm(dim=1)
        reach, least = max(reach, float(points_away.median())), FAR_CAMERA
        near_points = points_away <= FAR_POINT * reach
        points = points[near_points]
    for row in (away > least * reach).nonzero()[:, 0].tolist() if reach else ():
        near[row] = points is not None and _shows(points, cameras[row])
    names = zip(cameras.names, (away / max(reach, 1e-12)).tolist(), near.tolist(), strict=True)
    photos = {name: far for name, far, is_near in names if not is_near}
    count = 0 if near_points is None else int((~near_points).sum())
    rows = tuple((~near).nonzero()[:, 0].tolist())
    return near, near_points, Outliers(photos, rows, count)


def _shows(points: Float[Tensor, "M 3"], camera: Cameras) -> bool:
    """Whether points lie in several places of a camera's picture."""
    inside = points[is_in_image(points, camera)]
    pixels, _ = project(inside, camera)
    cells = (CELLS * pixels / torch.tensor(camera.size)).long()
    return len(cells.unique(dim=0)) >= OUTLIER_SHOWN


def scene_extent(cameras: Cameras) -> float:
    """Radius of the cameras around their mean, the official code's unit of length.

    Few cameras that are much farther away than the others do not count.
    """
    positions = cameras.positions
    away = (positions - positions.median(dim=0).values).norm(dim=1)
    most = away.sort().values[math.ceil(EXTENT_SHARE * len(away)) - 1]
    near = positions[away <= EXTENT_REACH * most] if most > 0 else positions
    return 1.1 * float((near - near.mean(dim=0)).norm(dim=-1).max()) or 1.0

"""The place that photos are of."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.poses import focus_point
from stylesplat.scene.projection import depths_of, shown
from stylesplat.scene.sampling import evenly

MAX_POINTS, MAX_CAMERAS = 5000, 100  # that are looked at
ROUNDS = 5  # of finding out which cameras look elsewhere
ASIDE = 3.0  # times the median by which a view axis passes the centre, beyond which it is not of it
BEYOND = 3.0  # times the median depth of the points: axes that meet farther off are near parallel
STEPS = 100  # of the geometric median
TINY = 1e-9


@dataclass(frozen=True)
class Centre:
    """What cameras look at."""

    place: Float[Tensor, "3"]
    """In the world, 64 bits."""
    outward: bool
    """Whether the cameras stand in its midst and look away from each other, as in a room."""


def find_centre(cameras: Cameras, points: Float[Tensor, "M 3"] | None) -> Centre:
    """Where the view axes meet, but for those of cameras that look elsewhere.

    Where they do not meet, or only far behind what is seen, it is the middle of the points: the
    geometric median, each point as often as photos show it. Without points it is that of the
    cameras.
    """
    met = _meeting_point(cameras)
    if points is None or not len(points):
        place = cameras.positions.double().mean(dim=0) if met is None else met
        return Centre(place, met is None and len(cameras) > 1)
    if met is not None and _depth(met[None], cameras) <= BEYOND * _depth(points, cameras):
        return Centre(met, outward=False)
    return Centre(_middle(cameras, points), met is None and _look_outward(cameras))


def _meeting_point(cameras: Cameras) -> Float[Tensor, "3"] | None:
    rows = list(range(len(cameras)))
    focus = None
    for _ in range(ROUNDS):
        try:
            focus = focus_point(cameras[rows])
        except StyleSplatError:  # the axes are parallel, or meet behind the cameras
            return None
        offsets = focus - cameras.positions.double()
        ahead = (offsets * cameras.viewmats[:, 2, :3].double()).sum(dim=1)
        aside = (offsets.square().sum(dim=1) - ahead.square()).clamp(min=0).sqrt()
        close = (aside <= ASIDE * aside.median() + TINY * ahead.median()) & (ahead > 0)
        kept = close.nonzero()[:, 0].tolist()
        if kept == rows or len(kept) < 2:
            break
        rows = kept
    return focus


def _depth(points: Float[Tensor, "M 3"], cameras: Cameras) -> float:
    """How far from the cameras points are in the median, of those in front of them."""
    some = points[:: max(1, len(points) // MAX_POINTS)].double()
    rows = evenly(range(len(cameras)), MAX_CAMERAS)
    depths = torch.cat([depths_of(some, cameras[row]) for row in rows])
    ahead = depths[depths > 0]
    return float(ahead.median()) if len(ahead) else 0.0


def _look_outward(cameras: Cameras) -> bool:
    """Whether cameras that stand apart look apart, rather than all the same way."""
    directions = cameras.viewmats[:, 2, :3].double()
    return len(cameras) > 1 and bool(directions.mean(dim=0).norm() < 0.9)


def _middle(cameras: Cameras, points: Float[Tensor, "M 3"]) -> Float[Tensor, "3"]:
    """The geometric median (Weiszfeld) of points, weighted by how many photos show them."""
    some = points[:: max(1, len(points) // MAX_POINTS)].double()
    rows = evenly(range(len(cameras)), MAX_CAMERAS)
    seen = torch.stack([shown(some, cameras[row]) for row in rows]).double().sum(dim=0)
    seen = seen if seen.any() else torch.ones_like(seen)
    middle = (seen[:, None] * some).sum(dim=0) / seen.sum()
    for _ in range(STEPS):
        pull = seen / (some - middle).norm(dim=1).clamp(min=TINY)
        middle = (pull[:, None] * some).sum(dim=0) / pull.sum()
    return middle

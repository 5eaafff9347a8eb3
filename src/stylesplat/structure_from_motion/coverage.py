"""From where photos show what is in their middle."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.frames import Frame

STRIDE = math.radians(45.5)  # around the centre: what lies between photos 45 apart is seen
STEEP = math.radians(75)  # above or below which a camera stands on no side
LEVELS_APART = math.radians(15)  # heights that differ by less are one
BEHIND = 0.25  # of the cameras' distance: what lies farther behind the centre is background
FLAT = 0.3  # share of points that a wall holds
WALL = 0.03  # of the cameras' distance: its thickness on each side
WALL_TURN = math.radians(50)  # by which it may face another way than to the cameras
TRIES = 2000  # planes through three points each


@dataclass(frozen=True)
class Coverage:
    """Directions around the up axis, in degrees."""

    arc: float
    """Of the full circle the part that photos show, between neighbours at most 45 apart."""
    largest_gap: float
    """Between neighbours."""
    sides: Float[Tensor, " S"]
    """Where cameras stand that are on a side at all, sorted; 0 is before what they look at."""
    heights: int
    """How many heights differ by 15 degrees or more."""
    lowest: float
    """Elevation above the centre, or of the view where cameras look outward."""
    highest: float
    """The same."""
    near: float
    """A tenth of the cameras is nearer to the centre; the median distance is 1."""
    far: float
    """A tenth is farther."""
    walk: float
    """How far apart the cameras stand: median distance from their middle."""
    outward: bool
    """Whether they stand in the midst and look out; sides are then those they look to."""
    facing: bool
    """Whether all look at one wall, behind which nothing is."""

    @property
    def elevations(self) -> str:
        """From the lowest to the highest, in words."""
        low, high = round(self.lowest), round(self.highest)
        if low < 0 < high:
            return f"{-low} degrees below to {high} above the middle"
        where = "below" if low < 0 else "above"
        return (
            f"{min(abs(low), abs(high))} to {max(abs(low), abs(high))} degrees {where} the middle"
        )


def measure_coverage(
    cameras: Cameras, points: Float[Tensor, "M 3"] | None, frame: Frame, *, outward: bool
) -> Coverage:
    """Measure from where cameras look at the origin of a frame.

    Args:
        cameras: In any world.
        points: In that world.
        frame: From there to where up is -y, the content is at the origin and the cameras at a
            median distance of 1.
        outward: Whether the cameras stand in the midst and look out.
    """
    positions = frame.place(cameras.positions.double())
    views = cameras.viewmats[:, 2, :3].double() @ frame.rotation.T.double()
    away = views if outward else torch.nn.functional.normalize(positions, dim=1)
    elevations = torch.asin((-away[:, 1]).clamp(-1, 1))
    level = elevations.abs() < STEEP
    sides = _sides(away[level])
    gaps = (sides.roll(-1) - sides) % (2 * math.pi)
    if len(gaps) and gaps.sum() < math.pi:  # all stand on one and the same side
        gaps[-1] += 2 * math.pi
    distances = positions.norm(dim=1)
    low, high = elevations.quantile(torch.tensor([0.05, 0.95]).double()).tolist()
    return Coverage(
        arc=math.degrees(2 * math.pi - float(gaps[gaps > STRIDE].sum())) if len(gaps) else 0.0,
        largest_gap=math.degrees(float(gaps.max())) if len(gaps) else 360.0,
        sides=sides.rad2deg(),
        heights=_levels(elevations),
        lowest=math.degrees(low),
        highest=math.degrees(high),
        near=float(distances.quantile(0.1)),
        far=float(distances.quantile(0.9)),
        walk=float((positions - positions.mean(dim=0)).norm(dim=1).median()),
        outward=outward,
        facing=not outward and points is not None and _is_walled(frame.place(points.double())),
    )


def _sides(away: Float[Tensor, "S 3"]) -> Float[Tensor, " S"]:
    """Angles around the up axis from 0 on, sorted, where -z is 0: before what cameras look at."""
    return (torch.atan2(away[:, 0], -away[:, 2]) % (2 * math.pi)).sort().values


def _levels(elevations: Float[Tensor, " C"]) -> int:
    """Heights that are apart, each taken from the lowest camera that the one before has not."""
    count, bound = 0, -math.inf
    for elevation in elevations.sort().values.tolist():
        if elevation >= bound:
            count, bound = count + 1, elevation + LEVELS_APART
    return count


def _is_walled(points: Float[Tensor, "M 3"], *, seed: int = 0) -> bool:
    """Whether an upright plane that faces the cameras holds much, and nothing lies behind it."""
    near = points[points.norm(dim=1) < 1]
    near = near[:: max(1, len(near) // 2000)]
    if len(near) < 3:
        return False
    generator = torch.Generator().manual_seed(seed)
    one, two, three = near[torch.randint(len(near), (TRIES, 3), generator=generator)].unbind(1)
    normals = torch.nn.functional.normalize(torch.linalg.cross(two - one, three - one), dim=1)
    normals = normals * normals[:, 2:].sign()  # away from the cameras
    faces = normals[:, 2] > math.cos(WALL_TURN)
    normals, offsets = normals[faces], (one * normals).sum(dim=1)[faces]
    depths = near @ normals.T - offsets  # behind it
    held = (depths.abs() < WALL).double().mean(dim=0)
    behind = (depths > BEHIND).double().mean(dim=0)
    return bool(((held > FLAT) & (behind < 0.05)).any())

"""Statistics of a posed capture: the directions it covers, and blur and exposure of its photos."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.exposure import photo_gains
from stylesplat.scene.frames import Frame
from stylesplat.structure_from_motion.image_measures import SIDE, relative_sharpness, sharpness

# Coverage; lengths are in units of the cameras' median distance from the centre
STRIDE = math.radians(45.5)  # around the centre: the gap between photos 45 degrees apart is covered
STEEP = math.radians(75)  # elevation above or below which a camera is on no side
HEIGHT_STEP = math.radians(15)  # elevations that differ by less are one height

MIN_PHOTOS_BY_POINTS = 0.5  # share of photos with enough points; else whole photos are compared
GAMMA = 2.2  # of sRGB, roughly


@dataclass(frozen=True, eq=False)
class Coverage:
    """Directions around the up axis, in degrees."""

    arc: float
    """Part of the full circle that photos show, where neighbours are at most 45 apart."""
    largest_gap: float
    """Between neighbours."""
    sides: Float[Tensor, " S"]
    """Directions of the cameras that are on a side at all, sorted; 0 is in front."""
    heights: int
    """How many heights differ by 15 degrees or more."""
    lowest: float
    """Elevation above the centre, or of the view where cameras look outward."""
    highest: float
    near: float
    """Distance from the centre that a tenth of the cameras is within; the median is 1."""
    far: float
    """Distance that a tenth of the cameras is beyond."""
    walk: float
    """How far apart the cameras stand: median distance from their mean."""
    outward: bool
    """Whether they stand in the midst and look out; sides are then those they look to."""

    @property
    def elevations(self) -> str:
        """From the lowest to the highest, in words."""
        low, high = round(self.lowest), round(self.highest)
        if low < 0 < high:
            return f"{-low} degrees below to {high} above the middle"
        low, high, where = (-high, -low, "below") if low < 0 else (low, high, "above")
        return f"{low} to {high} degrees {where} the middle"


def measure_coverage(cameras: Cameras, frame: Frame, *, outward: bool) -> Coverage:
    """Measure from where cameras look at the origin of a `working_frame`."""
    positions = frame.place(cameras.positions.double())
    views = cameras.viewmats[:, 2, :3].double() @ frame.rotation.T.double()
    away = views if outward else torch.nn.functional.normalize(positions, dim=1)
    elevations = torch.asin((-away[:, 1]).clamp(-1, 1))
    level = away[elevations.abs() < STEEP]
    # Angles around the up axis; 0 is -z, in front of what the cameras look at
    sides = (torch.atan2(level[:, 0], -level[:, 2]) % (2 * math.pi)).sort().values
    gaps = (sides.roll(-1) - sides) % (2 * math.pi)
    if len(gaps) and gaps.sum() < math.pi:  # all stand on one and the same side
        gaps[-1] += 2 * math.pi
    distances = positions.norm(dim=1)
    low, high = elevations.quantile(torch.tensor([0.05, 0.95]).double()).tolist()
    return Coverage(
        arc=math.degrees(2 * math.pi - float(gaps[gaps > STRIDE].sum())) if len(gaps) else 0.0,
        largest_gap=math.degrees(float(gaps.max())) if len(gaps) else 360.0,
        sides=sides.rad2deg(),
        heights=_count_heights(elevations),
        lowest=math.degrees(low),
        highest=math.degrees(high),
        near=float(distances.quantile(0.1)),
        far=float(distances.quantile(0.9)),
        walk=float((positions - positions.mean(dim=0)).norm(dim=1).median()),
        outward=outward,
    )


def _count_heights(elevations: Float[Tensor, " C"]) -> int:
    """Each height begins at the lowest camera above the height before."""
    count, bound = 0, -math.inf
    for elevation in elevations.sort().values.tolist():
        if elevation >= bound:
            count, bound = count + 1, elevation + HEIGHT_STEP
    return count


@dataclass(frozen=True, eq=False)
class PhotoStatistics:
    sharpness: Float[Tensor, " C"]
    """Relative to the median of the neighbours: 1 is typical, less is blurred."""
    stops: Float[Tensor, " C"]
    """How much brighter it is than the median photo, in stops; NaN if unknown."""
    warmth: Float[Tensor, " C"]
    """How much redder, against blue, in stops."""
    by_points: bool
    """Whether colours of the same points were compared, not those of whole photos."""


def measure_photos(capture: Capture) -> PhotoStatistics:
    small = at_most(capture, SIDE)
    sharp, means = [], []

    def measured() -> Iterator[tuple[Float[Tensor, "H W 3"], Cameras]]:
        for row in track(range(len(small)), "measuring photos", unit="photo"):
            photo, valid = small.photos[row], small.valid(row)
            grey = cv2.cvtColor(photo.numpy(), cv2.COLOR_RGB2GRAY)
            sharp.append(sharpness(grey, None if valid is None else valid.numpy()))
            colors = photo.flatten(0, 1) if valid is None else photo[valid]
            means.append((colors.float().mean(dim=0).clamp(min=1) / 255).log())
            if valid is not None:
                photo = photo * valid[..., None]  # black says nothing about exposure
            yield photo.float() / 255, small.cameras[row]

    logs = photo_gains(torch.zeros(0, 3) if small.points is None else small.points, measured())
    by_points = bool(logs.isfinite().all(dim=1).float().mean() > MIN_PHOTOS_BY_POINTS)
    stops = GAMMA / math.log(2) * (logs if by_points else torch.stack(means))
    stops = stops - stops.nanmedian(dim=0).values
    warmth = stops[:, 0] - stops[:, 2]
    relative = torch.tensor(relative_sharpness(sharp))
    return PhotoStatistics(relative, stops.mean(dim=1), warmth, by_points)

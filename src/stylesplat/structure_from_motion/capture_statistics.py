"""Statistics of a posed capture: the directions it covers, and blur and exposure of its photos."""

import math
from dataclasses import dataclass

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.frames import Frame
from stylesplat.scene.projection import is_in_image, project
from stylesplat.structure_from_motion.image_measures import SIDE, relative_sharpness, sharpness

# Coverage; lengths are in units of the cameras' median distance from the centre
STRIDE = math.radians(45.5)  # around the centre: the gap between photos 45 degrees apart is covered
STEEP = math.radians(75)  # elevation above or below which a camera is on no side
HEIGHT_STEP = math.radians(15)  # elevations that differ by less are one height
BEHIND = 0.25  # points farther behind a wall are something else
WALL_SHARE = 0.3  # of the points that a wall holds
WALL_THICKNESS = 0.03  # on each side
WALL_TURN = math.radians(50)  # between the wall's normal and the direction to the cameras
WALL_POINTS, WALL_PLANES = 2000, 2000  # that are used and tried

# Colours
MAX_POINTS = 4000  # whose colours are compared
MIN_POINTS = 30  # that a photo must show for that
MIN_PHOTOS_BY_POINTS = 0.5  # share of photos that show so many; else whole photos are compared
DARK, BRIGHT = 12, 243  # levels outside of which a colour says nothing about exposure
GAMMA = 2.2  # of sRGB, roughly


@dataclass(frozen=True)
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
    facing: bool
    """Whether all look at one wall, with nothing behind it."""

    @property
    def elevations(self) -> str:
        """From the lowest to the highest, in words."""
        low, high = round(self.lowest), round(self.highest)
        if low < 0 < high:
            return f"{-low} degrees below to {high} above the middle"
        low, high, where = (-high, -low, "below") if low < 0 else (low, high, "above")
        return f"{low} to {high} degrees {where} the middle"


def measure_coverage(
    cameras: Cameras, points: Float[Tensor, "M 3"] | None, frame: Frame, *, outward: bool
) -> Coverage:
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
        facing=not outward and points is not None and _is_wall(frame.place(points.double())),
    )


def _count_heights(elevations: Float[Tensor, " C"]) -> int:
    """Each height begins at the lowest camera above the height before."""
    count, bound = 0, -math.inf
    for elevation in elevations.sort().values.tolist():
        if elevation >= bound:
            count, bound = count + 1, elevation + HEIGHT_STEP
    return count


def _is_wall(points: Float[Tensor, "M 3"], *, seed: int = 0) -> bool:
    """Whether an upright plane that faces the cameras holds much, with nothing behind it."""
    near = points[points.norm(dim=1) < 1]
    near = near[:: max(1, len(near) // WALL_POINTS)]
    if len(near) < 3:
        return False
    generator = torch.Generator().manual_seed(seed)
    triples = torch.randint(len(near), (WALL_PLANES, 3), generator=generator)
    one, two, three = near[triples].unbind(1)
    normals = torch.nn.functional.normalize(torch.linalg.cross(two - one, three - one), dim=1)
    normals = normals * normals[:, 2:].sign()  # away from the cameras
    faces = normals[:, 2] > math.cos(WALL_TURN)
    normals, offsets = normals[faces], (one * normals).sum(dim=1)[faces]
    depths = near @ normals.T - offsets  # behind the plane
    held = (depths.abs() < WALL_THICKNESS).double().mean(dim=0)
    behind = (depths > BEHIND).double().mean(dim=0)
    return bool(((held > WALL_SHARE) & (behind < 0.05)).any())


@dataclass(frozen=True)
class PhotoStatistics:
    """One number a photo."""

    sharpness: Float[Tensor, " C"]
    """Relative to the median of the neighbours: 1 is typical, less is blurred."""
    stops: Float[Tensor, " C"]
    """How much brighter it is than the median photo, in stops; NaN if unknown."""
    warmth: Float[Tensor, " C"]
    """How much redder, against blue, in stops."""
    by_points: bool
    """Whether colours of the same points were compared, not those of whole photos."""


def measure_photos(capture: Capture) -> PhotoStatistics:
    points, colors = capture.points, capture.point_colors
    if points is None or colors is None:
        points, colors = torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.uint8)
    step = max(1, len(points) // MAX_POINTS)
    points, colors = points[::step], colors[::step]
    small = at_most(capture, SIDE)
    sharp, means, gains = [], [], []
    for row in track(range(len(small)), "measuring photos", unit="photo"):
        photo = small.photos[row]
        sharp.append(sharpness(cv2.cvtColor(photo.numpy(), cv2.COLOR_RGB2GRAY)))
        mean = photo.float().flatten(0, 1).mean(dim=0)
        means.append(GAMMA * (mean.clamp(min=1) / 255).log2())
        gains.append(_gain(photo, small.cameras[row], points, colors))
    stops = torch.stack(gains)  # [C, 3]
    by_points = bool(stops.isfinite().all(dim=1).float().mean() > MIN_PHOTOS_BY_POINTS)
    stops = stops if by_points else torch.stack(means)
    stops = stops - stops.nanmedian(dim=0).values
    warmth = stops[:, 0] - stops[:, 2]
    relative = torch.tensor(relative_sharpness(sharp))
    return PhotoStatistics(relative, stops.mean(dim=1), warmth, by_points)


def _gain(
    photo: UInt8[Tensor, "h w 3"],
    camera: Cameras,
    points: Float[Tensor, "M 3"],
    colors: UInt8[Tensor, "M 3"],
) -> Float[Tensor, "3"]:
    """Stops by which a photo shows points brighter than they are on average.

    The median tolerates that other things hide some of the points.
    """
    rows = is_in_image(points, camera).nonzero()[:, 0]
    pixels, _ = project(points[rows], camera)
    width, height = camera.size
    x, y = pixels.long().unbind(dim=1)
    here = photo[y.clamp(max=height - 1), x.clamp(max=width - 1)].float()
    average = colors[rows].float()
    valid = ((here > DARK) & (here < BRIGHT) & (average > DARK) & (average < BRIGHT)).all(dim=1)
    if valid.sum() < MIN_POINTS:
        return torch.full((3,), torch.nan)
    return GAMMA * (here[valid] / average[valid]).log2().median(dim=0).values

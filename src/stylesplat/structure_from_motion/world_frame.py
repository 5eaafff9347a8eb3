"""A world frame for poses without one: level, centred, of unit scale; the directions covered."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import photo_gains
from stylesplat.io.captures.colmap import posed_images, viewmats_of
from stylesplat.photo_libraries import cv2, pycolmap
from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras, focus_point, side_up, upright_up
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.frames import Frame
from stylesplat.scene.projection import depths_of, is_in_image
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.structure_from_motion.image_measures import (
    MEASURE_SIDE,
    relative_sharpness,
    sharpness,
)

WORLD_ROUNDS = 5  # of estimating something from the cameras, and leaving out outliers
MAX_ROLL = 0.2  # sine of a camera's roll (12 degrees), up to which it counts as held level
# Length of the level part of the mean view direction; photos all around have less
MIN_HEADING = 0.2
WORLD_TINY = 1e-9

# Centre
MAX_POINTS, MAX_CAMERAS = 5000, 100  # that are used
MAX_OFFSET = 3.0  # medians by which a view axis may miss the centre; others look elsewhere
WORLD_MAX_DEPTH = 3.0  # median depths of the points: axes that meet farther away are near parallel
MEDIAN_STEPS = 100  # of the geometric median


def move_to_working_frame(model: pycolmap.Reconstruction) -> Frame:
    """Move a reconstruction, which has no frame of its own, and return how; see `working_frame`."""
    images = posed_images(model)
    intrinsics = [model.cameras[image.camera_id] for image in images]
    cameras = Cameras(
        viewmats=viewmats_of(images).float(),
        Ks=torch.tensor(np.stack([c.calibration_matrix() for c in intrinsics])).float(),
        sizes=torch.tensor([(c.width, c.height) for c in intrinsics]),
        names=tuple(image.name for image in images),
    )
    points = np.stack([point.xyz for _, point in sorted(model.points3D.items())])
    frame = working_frame(cameras, torch.from_numpy(points).float())
    shift = np.zeros(3) if frame.shift is None else frame.shift.double().numpy()
    rotation = pycolmap.Rotation3d(frame.rotation.double().numpy())
    model.transform(pycolmap.Sim3d(frame.scale, rotation, shift))
    return frame


def working_frame(cameras: Cameras, points: Float[Tensor, "M 3"]) -> Frame:
    """The frame in which -y is up, the content is in the middle, and distances are about 1.

    y points down, as in the cameras' own OpenCV axes and as viewers of splats expect. Up is the
    direction that cameras which are held level agree on. The origin is what the cameras look at, z
    points ahead of them (of the first, where they stand all around), and their median distance is
    1. The same scene in another frame gives the same result.
    """
    centre = find_centre(cameras, points).position
    distance = float((cameras.positions.double() - centre).norm(dim=1).median())
    scale = 1 / distance if distance > WORLD_TINY else 1.0
    rotation = _axes(cameras, camera_up(cameras))
    return Frame(rotation, scale, -scale * rotation @ centre)


def camera_up(cameras: Cameras) -> Float[Tensor, "3"]:
    """The direction that is up for most cameras, without those that are rolled."""
    if (up := side_up(cameras)) is not None:
        return up
    up = upright_up(cameras)
    rows = list(range(len(cameras)))
    for _ in range(WORLD_ROUNDS):
        rolls = (cameras.viewmats[:, 0, :3].double() @ up).abs()
        kept = (rolls <= max(MAX_ROLL, float(rolls.median()))).nonzero()[:, 0].tolist()
        if kept == rows:
            break
        rows, up = kept, upright_up(cameras[kept])
    return up


def _axes(cameras: Cameras, up: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Rows: to the right, down, and ahead."""
    views, tops = cameras.viewmats[:, 2, :3].double(), -cameras.viewmats[:, 1, :3].double()
    # A camera that looks straight down has its top ahead
    choices = torch.stack([views.mean(dim=0), views[0], tops[0]])
    level = choices - (choices @ up)[:, None] * up
    lengths = level.norm(dim=1)
    row = 0 if lengths[0] > MIN_HEADING else 1 if lengths[1] > MIN_HEADING else 2
    ahead = normalize(level[row], dim=0)
    return torch.stack([torch.linalg.cross(-up, ahead), -up, ahead])


@dataclass(frozen=True, eq=False)
class Centre:
    position: Float[Tensor, "3"]
    outward: bool
    """Whether the cameras stand in its midst and look away from each other, as in a room."""


def find_centre(cameras: Cameras, points: Float[Tensor, "M 3"] | None) -> Centre:
    """The point where most view axes meet.

    Where they do not meet, or only far behind the points, it is the geometric median of the
    points, each weighted by the number of photos that show it. Without points it is the mean of
    the cameras.
    """
    met = _meeting_point(cameras)
    if points is None or not len(points):
        position = cameras.positions.double().mean(dim=0) if met is None else met
        return Centre(position, met is None and len(cameras) > 1)
    if met is not None and _depth(met[None], cameras) <= WORLD_MAX_DEPTH * _depth(points, cameras):
        return Centre(met, outward=False)
    mean_view = cameras.viewmats[:, 2, :3].double().mean(dim=0)
    apart = len(cameras) > 1 and bool(mean_view.norm() < 0.9)  # they do not all look one way
    return Centre(_geometric_median(cameras, points), met is None and apart)


def _meeting_point(cameras: Cameras) -> Float[Tensor, "3"] | None:
    """Where the view axes meet, without those of cameras that look elsewhere."""
    rows = list(range(len(cameras)))
    focus = None
    for _ in range(WORLD_ROUNDS):
        try:
            focus = focus_point(cameras[rows])
        except StyleSplatError:  # the axes are parallel, or meet behind the cameras
            return None
        offsets = focus - cameras.positions.double()
        ahead = (offsets * cameras.viewmats[:, 2, :3].double()).sum(dim=1)
        aside = (offsets.square().sum(dim=1) - ahead.square()).clamp(min=0).sqrt()
        close = (aside <= MAX_OFFSET * aside.median() + WORLD_TINY * ahead.median()) & (ahead > 0)
        kept = close.nonzero()[:, 0].tolist()
        if kept == rows or len(kept) < 2:
            break
        rows = kept
    return focus


def _some_points(points: Float[Tensor, "M 3"]) -> Float[Tensor, "m 3"]:
    return points[:: max(1, len(points) // MAX_POINTS)].double()


def _depth(points: Float[Tensor, "M 3"], cameras: Cameras) -> float:
    """The median depth of points, of those in front of the cameras."""
    rows = evenly_spaced(range(len(cameras)), MAX_CAMERAS)
    depths = torch.cat([depths_of(_some_points(points), cameras[row]) for row in rows])
    ahead = depths[depths > 0]
    return float(ahead.median()) if len(ahead) else 0.0


def _geometric_median(cameras: Cameras, points: Float[Tensor, "M 3"]) -> Float[Tensor, "3"]:
    """By Weiszfeld's algorithm; the weight of a point is the number of photos that show it."""
    points = _some_points(points)
    rows = evenly_spaced(range(len(cameras)), MAX_CAMERAS)
    weights = torch.stack([is_in_image(points, cameras[row]) for row in rows]).double().sum(dim=0)
    weights = weights if weights.any() else torch.ones_like(weights)
    median = (weights[:, None] * points).sum(dim=0) / weights.sum()
    for _ in range(MEDIAN_STEPS):
        pull = weights / (points - median).norm(dim=1).clamp(min=WORLD_TINY)
        median = (pull[:, None] * points).sum(dim=0) / pull.sum()
    return median


# Coverage; lengths are in units of the cameras' median distance from the centre
WORLD_STRIDE = math.radians(45.5)  # around the centre: gaps of 45 degrees are covered
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
    away = views if outward else normalize(positions, dim=1)
    elevations = torch.asin((-away[:, 1]).clamp(-1, 1))
    level = away[elevations.abs() < STEEP]
    # Angles around the up axis; 0 is -z, in front of what the cameras look at
    sides = (torch.atan2(level[:, 0], -level[:, 2]) % (2 * math.pi)).sort().values
    gaps = (sides.roll(-1) - sides) % (2 * math.pi)
    if len(gaps) and gaps.sum() < math.pi:  # all stand on one and the same side
        gaps[-1] += 2 * math.pi
    distances = positions.norm(dim=1)
    low, high = elevations.quantile(torch.tensor([0.05, 0.95]).double()).tolist()
    arc = 2 * math.pi - float(gaps[gaps > WORLD_STRIDE].sum()) if len(gaps) else 0.0
    return Coverage(
        arc=math.degrees(arc),
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
    small = at_most(capture, MEASURE_SIDE)
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

"""A world frame for photos whose poses come without one: level, centred, of unit scale."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import posed_images, viewmats_of
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.scene.cameras import Cameras, focus_point, up_vector
from stylesplat.scene.frames import Frame
from stylesplat.scene.projection import depths_of, is_in_image
from stylesplat.scene.sampling import evenly

ROUNDS = 5  # of estimating something from the cameras, and leaving out outliers
MAX_ROLL = 0.2  # sine of a camera's roll (12 degrees), up to which it counts as held level
# Length of the level part of the mean view direction; photos all around have less
MIN_HEADING = 0.2
TINY = 1e-9

# Centre
MAX_POINTS, MAX_CAMERAS = 5000, 100  # that are used
MAX_OFFSET = 3.0  # medians by which a view axis may miss the centre; others look elsewhere
MAX_DEPTH = 3.0  # median depths of the points: axes that meet farther away are near parallel
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
    scale = 1 / distance if distance > TINY else 1.0
    rotation = _axes(cameras, camera_up(cameras))
    return Frame(rotation, scale, -scale * rotation @ centre)


def camera_up(cameras: Cameras) -> Float[Tensor, "3"]:
    """The direction that is up for most cameras, without those that are rolled."""
    up = up_vector(cameras)
    rows = list(range(len(cameras)))
    for _ in range(ROUNDS):
        rolls = (cameras.viewmats[:, 0, :3].double() @ up).abs()
        kept = (rolls <= max(MAX_ROLL, float(rolls.median()))).nonzero()[:, 0].tolist()
        if kept == rows:
            break
        rows, up = kept, up_vector(cameras[kept])
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
    if met is not None and _depth(met[None], cameras) <= MAX_DEPTH * _depth(points, cameras):
        return Centre(met, outward=False)
    mean_view = cameras.viewmats[:, 2, :3].double().mean(dim=0)
    apart = len(cameras) > 1 and bool(mean_view.norm() < 0.9)  # they do not all look one way
    return Centre(_geometric_median(cameras, points), met is None and apart)


def _meeting_point(cameras: Cameras) -> Float[Tensor, "3"] | None:
    """Where the view axes meet, without those of cameras that look elsewhere."""
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
        close = (aside <= MAX_OFFSET * aside.median() + TINY * ahead.median()) & (ahead > 0)
        kept = close.nonzero()[:, 0].tolist()
        if kept == rows or len(kept) < 2:
            break
        rows = kept
    return focus


def _some_points(points: Float[Tensor, "M 3"]) -> Float[Tensor, "m 3"]:
    return points[:: max(1, len(points) // MAX_POINTS)].double()


def _depth(points: Float[Tensor, "M 3"], cameras: Cameras) -> float:
    """The median depth of points, of those in front of the cameras."""
    rows = evenly(range(len(cameras)), MAX_CAMERAS)
    depths = torch.cat([depths_of(_some_points(points), cameras[row]) for row in rows])
    ahead = depths[depths > 0]
    return float(ahead.median()) if len(ahead) else 0.0


def _geometric_median(cameras: Cameras, points: Float[Tensor, "M 3"]) -> Float[Tensor, "3"]:
    """By Weiszfeld's algorithm; the weight of a point is the number of photos that show it."""
    points = _some_points(points)
    rows = evenly(range(len(cameras)), MAX_CAMERAS)
    weights = torch.stack([is_in_image(points, cameras[row]) for row in rows]).double().sum(dim=0)
    weights = weights if weights.any() else torch.ones_like(weights)
    median = (weights[:, None] * points).sum(dim=0) / weights.sum()
    for _ in range(MEDIAN_STEPS):
        pull = weights / (points - median).norm(dim=1).clamp(min=TINY)
        median = (pull[:, None] * points).sum(dim=0) / pull.sum()
    return median

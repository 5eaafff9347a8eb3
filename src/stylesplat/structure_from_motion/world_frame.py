"""A world frame for photos whose poses come without one: level, centred, of unit scale."""

import math
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

# Ground plane; lengths are in units of the cameras' median distance from the centre
MAX_TILT = 15.0  # degrees by which the cameras may be wrong about what is level
TRIPLES = 20_000  # of points that planes are fitted to; one in a hundred is level in a room
MAX_PLANES = 500  # that are scored
THICKNESS = 0.01  # of a plane on each side
NEAR = 2.0  # points farther from the centre are ignored
MIN_INLIERS = 0.1  # share of the near points that a plane must hold
# Share of the points within three times its thickness: a slice of clutter holds a third of them
MIN_CONTRAST = 0.6
MIN_WIDTH = 0.15  # standard deviation along its shorter side


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
    direction that cameras which are held level agree on, or close to it the normal of the table or
    floor that things stand on. The origin is what the cameras look at, z points ahead of them (of
    the first, where they stand all around), and their median distance is 1. The same scene in
    another frame gives the same result.
    """
    centre = find_centre(cameras, points).position
    distance = float((cameras.positions.double() - centre).norm(dim=1).median())
    scale = 1 / distance if distance > TINY else 1.0
    up = camera_up(cameras)
    normal = ground_normal(scale * (points.double() - centre), up)
    rotation = _axes(cameras, up if normal is None else normal)
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


@dataclass(frozen=True)
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


def ground_normal(
    points: Float[Tensor, "M 3"], up: Float[Tensor, "3"], *, seed: int = 0
) -> Float[Tensor, "3"] | None:
    """The upward normal of the near level plane that holds most points; None if none is clear.

    The first guess is by RANSAC.
    """
    near = points[points.norm(dim=1) < NEAR]
    near = near[:: max(1, len(near) // MAX_POINTS)]
    if len(near) < 3:
        return None
    generator = torch.Generator().manual_seed(seed)
    one, two, three = near[torch.randint(len(near), (TRIPLES, 3), generator=generator)].unbind(1)
    normals = normalize(torch.linalg.cross(two - one, three - one), dim=1)
    normals = normals * (normals @ up).sign()[:, None]
    least = math.cos(math.radians(MAX_TILT))
    level = (normals @ up > least).nonzero()[:MAX_PLANES, 0]
    if not len(level):
        return None
    normals, offsets = normals[level], (one[level] * normals[level]).sum(dim=1)
    close = (near @ normals.T - offsets).abs() < THICKNESS  # [M, planes]
    inliers, fits = close[:, close.sum(dim=0).argmax()], 0
    while True:
        if inliers.sum() < 3:
            return None
        centre = near[inliers].mean(dim=0)
        variances, axes = torch.linalg.eigh(torch.cov((near[inliers] - centre).T, correction=0))
        normal = axes[:, 0] * (axes[:, 0] @ up).sign()
        distances = ((near - centre) @ normal).abs()
        fits += 1
        if fits > ROUNDS:
            break
        inliers = distances < THICKNESS
    clear = inliers.sum() >= MIN_CONTRAST * (distances < 3 * THICKNESS).sum()
    large = variances[1] >= MIN_WIDTH**2 and inliers.double().mean() >= MIN_INLIERS
    return normal if clear and large and normal @ up > least else None

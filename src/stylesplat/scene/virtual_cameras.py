"""Cameras that nobody photographed with: framing content, rings, orbits, paths of key frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras, focus_point, look_at, median_lens, up_vector
from stylesplat.scene.content import Content, content_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats

# The model: the content is a convex hull that fills the picture, and other Gaussians are discs that
# hide part of its middle. A camera stands as far away as it needs, or before the first of these.
FILLED = 0.92  # share of the picture's width or height
VIRTUAL_CLEAR = 0.5  # least distance of the camera from the content's nearest point, in its radii
VIRTUAL_NEAREST = 0.1  # least distance of the camera in world units; the near plane is at 0.01
WIDEST = 0.5  # least focal length over the picture's width: 90 degrees
VIRTUAL_HIDDEN = 0.1  # share of the content's middle that other Gaussians may hide
MIDDLE = 0.6  # radius of the middle, in the content's radii
BEFORE = 0.95  # share of the distance to what would hide the content, where the camera stands
VIRTUAL_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class ViewDirection:
    """A camera without its distance: the point that it looks at, its direction, its size."""

    focus: Float[Tensor, "3"]
    outward: Float[Tensor, "3"]
    """The unit vector from the focus to the camera."""
    up: Float[Tensor, "3"]
    size: tuple[int, int]
    """Width and height in pixels."""

    def offsets(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        """Points in the camera's axes, from the focus."""
        return (points - self.focus) @ self.viewmats(1.0)[0, :3, :3].T

    def viewmats(self, distance: float) -> Float[Tensor, "1 4 4"]:
        """World to camera, at a distance from the focus."""
        eye = self.focus + distance * self.outward
        return look_at(eye[None], self.focus, self.up)

    @property
    def half(self) -> Float[Tensor, "2"]:
        """Pixels from the middle that may be filled, across and down."""
        return FILLED * torch.tensor(self.size).double() / 2


def camera_distance(content: Content, sights: Sequence[ViewDirection], focal: float) -> float:
    """The distance at which the content fills the pictures of all sights, if nothing hides it.

    Where other Gaussians would hide it, the camera stands before them, and `focal_at` gives a
    shorter focal length than the wanted one.
    """
    wanted, closest, free = [], [], []
    for sight in sights:
        offsets = sight.offsets(content.outline)
        radius = max(float(offsets.norm(dim=1).max()), VIRTUAL_TINY)
        for distances, lens in ((wanted, focal), (closest, WIDEST * sight.size[0])):
            needed = (offsets[:, :2].abs() * lens / sight.half).amax(dim=1)
            distances.append(
                float((needed.clamp(min=VIRTUAL_CLEAR * radius) - offsets[:, 2]).max())
            )
        free.append(BEFORE * _free_distance(content, sight, radius))
    return max(min(max(wanted), max(*closest, min(free))), VIRTUAL_NEAREST)


def focal_at(points: Float[Tensor, "M 3"], sight: ViewDirection, distance: float) -> float:
    """The focal length in pixels at which points fill the picture."""
    offsets = sight.offsets(points)
    lateral = offsets[:, :2].abs().clamp(min=VIRTUAL_TINY * distance)
    depths = (distance + offsets[:, 2:]).clamp(min=VIRTUAL_TINY * distance)
    return float((sight.half * depths / lateral).min())


def level_axes(up: Float[Tensor, "3"]) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Two directions perpendicular to up and to each other."""
    side = torch.linalg.cross(up, torch.eye(3).to(up)[up.abs().argmin()])
    side = torch.nn.functional.normalize(side, dim=0)
    return side, torch.linalg.cross(up, side)


def centred_K(focal: float, size: tuple[int, int]) -> Float[Tensor, "3 3"]:
    """Intrinsics with the principal point in the middle of the picture."""
    width, height = size
    return torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])


def cameras_of(
    viewmats: Float[Tensor, "M 4 4"],
    Ks: Float[Tensor, "*M 3 3"],
    size: tuple[int, int],
    *,
    names: str,
) -> Cameras:
    """Cameras of one size, with one lens or one each; their numbers are put into `names`."""
    count = len(viewmats)
    return Cameras(
        viewmats=viewmats.float(),
        Ks=Ks.float().expand(count, 3, 3),
        sizes=torch.tensor(size).repeat(count, 1),
        names=tuple(names.format(row) for row in range(count)),
    )


def _free_distance(content: Content, sight: ViewDirection, radius: float) -> float:
    """The distance from which something else hides the middle of the content."""
    offsets = content.others - sight.focus
    ahead = offsets @ sight.outward
    aside = (offsets.square().sum(dim=1) - ahead.square()).clamp(min=0).sqrt()
    middle = MIDDLE * radius
    between = (ahead > 0) & (aside < middle + content.blurs)
    blurs = content.blurs[between]
    # Nearest to the content first, at their near side, which the camera has to stand before
    along, order = (ahead[between] - blurs).sort()
    hidden = content.areas[between] / (torch.pi * (middle**2 + blurs.square()))
    walls = along[hidden[order].cumsum(0) > VIRTUAL_HIDDEN]
    return float(walls[0]) if len(walls) else math.inf


VIRTUAL_VIEWS = 36
VIRTUAL_SIZE = (960, 720)  # pixels; upright for tall content
VIRTUAL_TALL = 1.2  # least height of tall content, in its widths
FOCAL = 960.0  # pixels, where there is room enough
ELEVATIONS = (10.0, 35.0)  # degrees, by turns
EACH = 4  # one view in four is a close-up
VIRTUAL_PARTS = 3  # of the content along its longest axis, one in each close-up
ZOOM = 2.0  # least magnification of close-ups
VIRTUAL_NAMES = "view_{:03d}.png"


def ring_cameras(splats: Splats, up: Float[Tensor, "3"]) -> Cameras:
    """Cameras all around the content: three of four show all of it, one is a close-up of a part."""
    content = content_of(splats)
    parts = [content.outline_of(part) for part in _parts_along(content.points)]
    up = torch.nn.functional.normalize(up.double(), dim=0)
    side, ahead = level_axes(up)
    outline = content.outline @ torch.stack([side, ahead, up], dim=1)
    lengths = outline.amax(dim=0) - outline.amin(dim=0)
    size = (
        (VIRTUAL_SIZE[1], VIRTUAL_SIZE[0])
        if lengths[2] > VIRTUAL_TALL * lengths[:2].max()
        else VIRTUAL_SIZE
    )
    viewmats, focals = [], []
    for row in range(VIRTUAL_VIEWS):
        turn = 2 * math.pi * row / VIRTUAL_VIEWS
        round, place = divmod(row, EACH)
        close = place == EACH - 1
        tilt = math.radians(ELEVATIONS[(round if close else place) % len(ELEVATIONS)])
        level = math.cos(turn) * side + math.sin(turn) * ahead
        outward = math.cos(tilt) * level + math.sin(tilt) * up
        sight = ViewDirection(content.extent.centre, outward, up, size)
        distance = camera_distance(content, [sight], FOCAL)
        focal = focal_at(content.outline, sight, distance)
        if close:
            part = parts[round % VIRTUAL_PARTS]
            sight = replace(sight, focus=(part.amin(dim=0) + part.amax(dim=0)) / 2)
            focal = max(ZOOM * focal, focal_at(part, sight, distance))
        viewmats.append(sight.viewmats(distance)[0])
        focals.append(focal)
    Ks = torch.stack([centred_K(focal, size) for focal in focals])
    return cameras_of(torch.stack(viewmats), Ks, size, names=VIRTUAL_NAMES)


def has_rendered_views(scene: Scene) -> bool:
    """Whether a scene came without photos, so that its views are those of `ring_cameras`."""
    return scene.capture is None and scene.cameras.names == tuple(
        map(VIRTUAL_NAMES.format, range(VIRTUAL_VIEWS))
    )


def _parts_along(points: Float[Tensor, "M 3"]) -> list[Float[Tensor, "_ 3"]]:
    """Points in three parts along their principal axis; an empty part holds all points."""
    offsets = points - points.mean(dim=0)
    _, axes = torch.linalg.eigh(offsets.T @ offsets)  # the widest one comes last
    along = offsets @ axes[:, -1]
    low, high = along.min(), along.max()
    part_of = (
        ((along - low) / (high - low).clamp(min=1e-12) * VIRTUAL_PARTS)
        .long()
        .clamp(max=VIRTUAL_PARTS - 1)
    )
    parts = [points[part_of == part] for part in range(VIRTUAL_PARTS)]
    return [part if len(part) else points for part in parts]


MOST_FRAMES = 36_000  # twenty minutes at 30 a second


def smooth_path(
    viewmats: Float[Tensor, "F 4 4"],
    focals: Float[Tensor, " F"],
    count: int,
    size: tuple[int, int],
    *,
    closed: bool = False,
) -> Cameras:
    """A path through key frames: splines of positions, rotations and logarithms of focal lengths.

    `focals` are in units of the pictures' height. A closed path of `count` frames returns to the
    first key frame, which it does not repeat.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    keys = len(focals)
    # A closed path is the middle one of three rounds, so that it is smooth where it closes
    rows = np.tile(np.arange(keys), 3 if closed else 1)
    begin, end = (keys, 2 * keys) if closed else (0, keys - 1)
    times, keyed = np.linspace(begin, end, count, endpoint=not closed), np.arange(len(rows))
    rotations = viewmats[:, :3, :3].double().numpy()
    turns = RotationSpline(keyed, Rotation.from_matrix(rotations[rows]))(times).as_matrix()
    positions = -np.einsum("cji,cj->ci", rotations, viewmats[:, :3, 3].double().numpy())
    positions = CubicSpline(keyed, positions[rows], bc_type="natural")(times)
    lenses = np.log(focals.double().numpy())
    lenses = np.exp(CubicSpline(keyed, lenses[rows], bc_type="natural")(times))
    path = torch.eye(4).repeat(count, 1, 1)
    path[:, :3, :3] = torch.from_numpy(turns)
    path[:, :3, 3] = -torch.from_numpy(np.einsum("cij,cj->ci", turns, positions))
    return path_of(path, torch.from_numpy(lenses).float(), size)


def path_of(
    viewmats: Float[Tensor, "M 4 4"], focals: Float[Tensor, " M"], size: tuple[int, int]
) -> Cameras:
    """The frames of a path; `focals` are in units of the pictures' height."""
    Ks = torch.stack([centred_K(focal * size[1], size) for focal in focals.tolist()])
    return cameras_of(viewmats, Ks, size, names="path_{:05d}.png")


def frame_count(seconds: float | int, fps: float | int) -> int:
    """The number of frames of a video; refuses none and more than `MOST_FRAMES`."""
    count = round(seconds * fps) if 0 < seconds * fps < float("inf") else 0
    if not 0 < count <= MOST_FRAMES:
        raise StyleSplatError(
            f"Cannot render {seconds:g} seconds at {fps:g} frames a second. Choose between 1 and "
            f"{MOST_FRAMES:,} frames in all."
        )
    return count


MAX_GAP = math.radians(100)  # a circle passes over stretches without photos up to this wide
RADIUS_RANK = 0.75  # of the photos' distances: close-ups would cut off what the others show whole
SWAY = 0.5  # height varies along the path by this share of the captures' own deviation
LENS = 1.0  # focal length over a picture's longer side around content, where there is room enough
TILT, NOD = math.radians(20), math.radians(8)  # of a path around content: its mean, and how varied
SWING = math.radians(35)  # of a view that turns to and fro, at each side
# Sine of the angle to the vertical below which photos surround the focus evenly
VIRTUAL_EVEN = 1e-3
UP = torch.tensor([0.0, 0.0, 1.0]).double()  # where it is not known
VIRTUAL_WINDOW = (1600, 1200)  # pixels that all content fits into at the start
ORBIT_FOCAL = 1450.0  # pixels: 45 degrees from the top to the bottom
FRAME_NAME = "orbit_{:04d}.png"
MIN_DISTANCE = 0.1  # to what the first camera looks at, should the middle lie behind it


def orbit_cameras(cameras: Cameras, count: int, focus: Float[Tensor, "3"] | None = None) -> Cameras:
    """A smooth closed path around what the cameras look at, looking at it.

    The path stays where photos were taken: a full circle if they surround the scene, else to and
    fro over the arc that they cover. The height is the photos' mean, with some of their spread, and
    the distance is that of the farther ones. The cameras have one even size and the lens of the
    photo whose view is median in width. They look at `focus`, by default the point that the
    capture's cameras look at.
    """
    focus = focus_point(cameras) if focus is None else focus.double()
    axes = _axes(cameras, focus)
    local = (cameras.positions.double() - focus) @ axes.T  # two horizontal numbers, then up
    radius = local[:, :2].norm(dim=-1).quantile(RADIUS_RANK)
    phase = _phases(count)
    azimuth = _azimuths(torch.atan2(local[:, 1], local[:, 0]), phase)
    height = local[:, 2].mean() + SWAY * local[:, 2].std(correction=0) * phase.sin()
    path = torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), height], dim=-1)
    K, size = median_lens(cameras)
    return cameras_of(look_at(focus + path @ axes, focus, axes[2]), K, size, names=FRAME_NAME)


def zoom_to_content(path: Cameras, content: Content) -> Cameras:
    """The path with the focal length at which all content just fits into every frame."""
    centre, tops = content.extent.centre, -path.viewmats[:, 1, :3].double()
    outward = path.positions.double() - centre
    far = outward.norm(dim=1, keepdim=True)
    frames = zip(outward / far, tops, far[:, 0].tolist(), strict=True)
    focal = min(
        focal_at(content.outline, ViewDirection(centre, each, top, path.size), distance)
        for each, top, distance in frames
    )
    return replace(path, Ks=centred_K(focal, path.size).to(path.Ks).expand_as(path.Ks))


def orbit_around(content: Content, views: Cameras, count: int) -> Cameras:
    """A smooth closed path around the content of a splat without photos, all of it in every frame.

    The pictures are upright as the views are, and of their size.
    """
    up, size = up_vector(views), views.size
    focal = LENS * max(size)
    side, ahead = level_axes(up)
    phase = _phases(count)
    tilt = (TILT + NOD * phase.sin())[:, None]
    level = phase.cos()[:, None] * side + phase.sin()[:, None] * ahead
    outward = tilt.cos() * level + tilt.sin() * up
    sights = [ViewDirection(content.extent.centre, each, up, size) for each in outward]
    distance = camera_distance(content, sights, focal)
    focal = min(focal_at(content.outline, sight, distance) for sight in sights)
    viewmats = torch.cat([sight.viewmats(distance) for sight in sights])
    return cameras_of(viewmats, centred_K(focal, size), size, names=FRAME_NAME)


def turned_view(
    view: Cameras,
    centre: Float[Tensor, "3"],
    up: Float[Tensor, "3"],
    count: int,
    path: Literal["circle", "swing"],
) -> Cameras:
    """A closed path of one camera around the vertical axis through a point."""
    phase = _phases(count)
    angles = phase if path == "circle" else SWING * phase.sin()
    pivot, axis = torch.eye(4).double().repeat(2, 1, 1), up.double()
    pivot[0, :3, 3], pivot[1, :3, 3] = centre.double(), -centre.double()
    turns = torch.eye(4).double().repeat(count, 1, 1)
    cross = torch.linalg.cross(torch.eye(3).double(), axis.expand(3, 3))
    turns[:, :3, :3] = torch.matrix_exp(angles[:, None, None] * cross)
    viewmats = view.viewmats.double() @ pivot[0] @ turns @ pivot[1]
    return cameras_of(viewmats, view.Ks, view.size, names=FRAME_NAME)


def _phases(count: int) -> Float[Tensor, " M"]:
    return 2 * math.pi * torch.arange(count, dtype=torch.float64) / count


def _axes(cameras: Cameras, focus: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Rows, right-handed: from the focus towards the cameras, sideways, up."""
    up = up_vector(cameras)
    outward = cameras.positions.double().mean(dim=0) - focus
    side = torch.linalg.cross(up, outward)
    if side.norm() < VIRTUAL_EVEN * outward.norm():  # surrounded evenly: any direction will do
        side = level_axes(up)[0]
    side = torch.nn.functional.normalize(side, dim=0)
    return torch.stack([torch.linalg.cross(side, up), side, up])


def _azimuths(photos: Float[Tensor, " C"], phase: Float[Tensor, " M"]) -> Float[Tensor, " M"]:
    """Angles along the path, by where around the focus the photos were taken."""
    photos = photos.sort().values
    gaps = photos.roll(-1) - photos
    gaps[-1] += 2 * math.pi
    widest = int(gaps.argmax())
    if gaps[widest] < MAX_GAP:
        return phase
    start, end = photos[(widest + 1) % len(photos)], photos[widest]
    arc = (end - start) % (2 * math.pi)
    return start + arc * (0.5 - 0.5 * phase.cos())


@dataclass(frozen=True, eq=False)
class FirstView:
    """The upright camera that a viewer starts with."""

    position: Float[Tensor, "3"]
    target: Float[Tensor, "3"]
    """The point that it looks at and turns around."""
    up: Float[Tensor, "3"]
    """The upward direction, of length 1."""
    slopes: tuple[float, float]
    """Width and height of the view at distance 1."""


def first_view(splats: Splats, cameras: Cameras | None) -> FirstView:
    """Returns the camera of the first photo, or without photos one that sees all content."""
    content = content_of(splats)
    middle = content.extent.centre
    if cameras is not None:
        position, forward = cameras.positions[0].double(), cameras.viewmats[0, 2, :3].double()
        target = position + ((middle - position) @ forward).clamp(min=MIN_DISTANCE) * forward
        width, height = cameras.sizes[0].tolist()
        slopes = width / float(cameras.Ks[0, 0, 0]), height / float(cameras.Ks[0, 1, 1])
        return FirstView(position, target, up_vector(cameras), slopes)
    outward = torch.nn.functional.normalize(torch.ones(3).double(), dim=0)
    sight = ViewDirection(middle, outward, UP, VIRTUAL_WINDOW)
    distance = camera_distance(content, [sight], ORBIT_FOCAL)
    focal = focal_at(content.outline, sight, distance)
    slopes = VIRTUAL_WINDOW[0] / focal, VIRTUAL_WINDOW[1] / focal
    return FirstView(middle + distance * outward, middle, UP, slopes)

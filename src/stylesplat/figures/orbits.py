"""Camera paths around a scene, and where a viewer starts."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras, focus_point, look_at, median_lens, up_vector
from stylesplat.scene.content import Content, content_of
from stylesplat.scene.framing import (
    Sight,
    cameras_of,
    centred_K,
    fitting_distance,
    focal_at,
    level_axes,
)
from stylesplat.scene.splats import Splats

MAX_GAP = math.radians(100)  # a circle passes over stretches without photos up to this wide
RADIUS_RANK = 0.75  # of the photos' distances: close-ups would cut off what the others show whole
SWAY = 0.5  # height varies along the path by this share of the captures' own deviation
LENS = 1.0  # focal length over a picture's longer side around content, where there is room enough
TILT, NOD = math.radians(20), math.radians(8)  # of a path around content: its mean, and how varied
SWING = math.radians(35)  # of a view that turns to and fro, at each side
EVEN = 1e-3  # sine of the angle to the vertical below which photos surround the focus evenly
UP = torch.tensor([0.0, 0.0, 1.0]).double()  # where it is not known
WINDOW = (1600, 1200)  # pixels that all content fits into at the start
FOCAL = 1450.0  # pixels: 45 degrees from the top to the bottom
FRAMES = "orbit_{:04d}.png"
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
    return cameras_of(look_at(focus + path @ axes, focus, axes[2]), K, size, names=FRAMES)


def zoom_to_content(path: Cameras, content: Content) -> Cameras:
    """The path with the focal length at which all content just fits into every frame."""
    centre, tops = content.extent.centre, -path.viewmats[:, 1, :3].double()
    outward = path.positions.double() - centre
    far = outward.norm(dim=1, keepdim=True)
    frames = zip(outward / far, tops, far[:, 0].tolist(), strict=True)
    focal = min(
        focal_at(content.outline, Sight(centre, each, top, path.size), distance)
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
    sights = [Sight(content.extent.centre, each, up, size) for each in outward]
    distance = fitting_distance(content, sights, focal)
    focal = min(focal_at(content.outline, sight, distance) for sight in sights)
    viewmats = torch.cat([sight.viewmats(distance) for sight in sights])
    return cameras_of(viewmats, centred_K(focal, size), size, names=FRAMES)


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
    return cameras_of(viewmats, view.Ks, view.size, names=FRAMES)


def _phases(count: int) -> Float[Tensor, " M"]:
    return 2 * math.pi * torch.arange(count, dtype=torch.float64) / count


def _axes(cameras: Cameras, focus: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Rows, right-handed: from the focus towards the cameras, sideways, up."""
    up = up_vector(cameras)
    outward = cameras.positions.double().mean(dim=0) - focus
    side = torch.linalg.cross(up, outward)
    if side.norm() < EVEN * outward.norm():  # surrounded evenly: any direction will do
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
    sight = Sight(middle, outward, UP, WINDOW)
    distance = fitting_distance(content, [sight], FOCAL)
    focal = focal_at(content.outline, sight, distance)
    slopes = WINDOW[0] / focal, WINDOW[1] / focal
    return FirstView(middle + distance * outward, middle, UP, slopes)

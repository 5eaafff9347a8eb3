"""Cameras for a splat that came without photos."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of
from stylesplat.scene.framing import Sight, centred_K, distances, focal_at, level_axes
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats

VIEWS = 36
SIZE = (960, 720)  # pixels; upright for what is taller than wide
TALL = 1.2  # times as tall as wide, from which that is so
FOCAL = 960.0  # pixels, where there is room enough
ELEVATIONS = (10.0, 35.0)  # degrees, by turns
EACH = 4  # one view in so many is a close-up
PARTS = 3  # of the content along its longest axis, which close-ups show by turns
ZOOM = 2.0  # times larger than in the other views, at least, is what they show
NAMES = tuple(f"view_{row:03d}.png" for row in range(VIEWS))


def ring_cameras(splats: Splats, up: Float[Tensor, "3"]) -> Cameras:
    """Cameras all around the content: three of four show all of it, one comes close to a part.

    They stand before what would hide the content, such as the walls of a room, with a wider lens
    where that is close.

    Args:
        splats: What to look at.
        up: The direction that is up.
    """
    content = content_of(splats)
    parts = [content.outline_of(part) for part in _parts(content.points)]
    up = torch.nn.functional.normalize(up.double(), dim=0)
    side, ahead = level_axes(up)
    size = _picture_size(content.outline @ torch.stack([side, ahead, up], dim=1))
    viewmats, focals = [], []
    for row in range(VIEWS):
        turn = 2 * math.pi * row / VIEWS
        round, place = divmod(row, EACH)
        close = place == EACH - 1
        tilt = math.radians(ELEVATIONS[(round if close else place) % len(ELEVATIONS)])
        level = math.cos(turn) * side + math.sin(turn) * ahead
        outward = math.cos(tilt) * level + math.sin(tilt) * up
        sight = Sight(content.extent.centre, outward, up, size)
        distance = distances(content, sight, FOCAL).best
        focal = focal_at(content.outline, sight, distance)
        if close:
            part = parts[round % PARTS]
            sight = replace(sight, focus=(part.amin(dim=0) + part.amax(dim=0)) / 2)
            focal = max(ZOOM * focal, focal_at(part, sight, distance))
        viewmats.append(sight.viewmats(distance)[0])
        focals.append(focal)
    return Cameras(
        viewmats=torch.stack(viewmats).float(),
        Ks=torch.stack([centred_K(focal, size) for focal in focals]),
        sizes=torch.tensor(size).expand(VIEWS, 2).clone(),
        names=NAMES,
    )


def has_no_photos(scene: Scene) -> bool:
    """Whether a scene came without photos, so that its views are those of `ring_cameras`."""
    return scene.capture is None and scene.cameras.names == NAMES


def _picture_size(points: Float[Tensor, "M 3"]) -> tuple[int, int]:
    """Width and height of pictures of points, of which the last coordinate points up."""
    lengths = points.amax(dim=0) - points.amin(dim=0)
    return (SIZE[1], SIZE[0]) if lengths[2] > TALL * lengths[:2].max() else SIZE


def _parts(points: Float[Tensor, "M 3"]) -> list[Float[Tensor, "_ 3"]]:
    """Points by where they lie along the axis that they extend along most; all where none do."""
    offsets = points - points.mean(dim=0)
    _, axes = torch.linalg.eigh(offsets.T @ offsets)  # the widest one comes last
    along = offsets @ axes[:, -1]
    low, high = along.min(), along.max()
    part_of = ((along - low) / (high - low).clamp(min=1e-12) * PARTS).long().clamp(max=PARTS - 1)
    parts = [points[part_of == part] for part in range(PARTS)]
    return [part if len(part) else points for part in parts]

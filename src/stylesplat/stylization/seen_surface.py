"""An object's surface, as cameras see it: the first thing in each of their pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED, TINY_COVERAGE, coverage, without_looks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import depths_of, pixel_centres, project, unproject
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.shapes import extent
from stylesplat.stylization.object_views import Box, around, typical_length

VIEWS = 32
LENGTH = 200  # longer side of the object in them, in pixels
SOLID = 0.7  # coverage from which a pixel shows the surface
BEHIND = 0.04  # of the object's extent: what lies so far behind the mean depth is another side
GRAZING = 0.25  # cosine, below which depths tell little


@dataclass(frozen=True)
class Surface:
    """Points of a surface, one for each pixel that shows it."""

    points: Float[Tensor, "P 3"]
    normals: Float[Tensor, "P 3"]
    """Towards the camera that saw it, of length 1."""
    colors: Float[Tensor, "P 3"]
    """In 0..1."""
    pixel: float
    """How large a pixel of a view is there, typically, in which the object is `LENGTH` long."""


@torch.no_grad()
def seen_surface(splats: Splats, picked: Bool[Tensor, " N"], boxes: Sequence[Box]) -> Surface:
    """Where an object's surface is.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        boxes: Where it lies in views to choose from.
    """
    zoom = LENGTH / typical_length(boxes)
    cuts = [around(box, zoom, (1, 1))[0] for box in evenly(boxes, VIEWS)]
    far = BEHIND * extent(splats.means[picked])

    alone = without_looks(splats[picked])
    everyone = torch.ones(len(alone), dtype=torch.bool, device=splats.device)

    def look(camera: Cameras) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        return *_look(splats, picked, camera, far), coverage(alone, camera, everyone)

    seen = track(at_once(look, cuts, splats.device), "looking for the surface", total=len(cuts))
    *parts, outlines = zip(*seen, strict=True)
    points, normals, colors, sizes = (torch.cat(each) for each in parts)
    kept = torch.ones(len(points), dtype=torch.bool, device=points.device)
    for camera, outline in zip(cuts, outlines, strict=True):
        kept &= ~_beside(points, camera, outline)
    return Surface(points[kept], normals[kept], colors[kept], float(sizes.median()))


def _look(
    splats: Splats, picked: Tensor, camera: Cameras, far: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Points, normals, colours and sizes of the pixels of one camera that show the surface."""
    image, covered, depths = _depths(splats, picked, camera)
    first = picked & ~_behind(splats, camera, depths + far)
    _, own, depths = _depths(splats, first, camera)
    width, height = camera.size
    points = unproject(pixel_centres(width, height).to(depths), depths.flatten(), camera)
    points = points.view(height, width, 3)
    normals, sure = _normals(points, camera.positions.to(points))
    sure &= (covered > SOLID) & (own > SOLID / 2)
    sizes = depths / camera.Ks[0, 0, 0].to(depths)
    return points[sure], normals[sure], image[sure], sizes[sure]


def _depths(splats: Splats, picked: Tensor, camera: Cameras) -> tuple[Tensor, Tensor, Tensor]:
    """The image, some Gaussians' coverage, and how far they are."""
    mine = picked.to(splats.means)
    features = torch.stack([mine, mine * depths_of(splats.means, camera)], dim=1)
    image, _ = render(splats, camera, features=features)
    colors, covered, depths = image.split((3, 1, 1), dim=2)
    covered, depths = covered[..., 0], depths[..., 0]
    return colors, covered, depths / covered.clamp(min=TINY_COVERAGE)


def _behind(splats: Splats, camera: Cameras, depths: Float[Tensor, "H W"]) -> Tensor:
    """Which Gaussians lie behind the depths of their pixels; those beside the image do not."""
    inside, there = _looked_up(splats.means, camera, depths)
    own = depths_of(splats.means[inside], camera)
    return inside.masked_scatter(inside, own > there)


def _beside(points: Tensor, camera: Cameras, outline: Float[Tensor, "H W"]) -> Tensor:
    """Which points lie beside the object in a camera's image, were nothing before it."""
    inside, there = _looked_up(points, camera, outline)
    return inside.masked_scatter(inside, there < COVERED)


def _looked_up(
    points: Float[Tensor, "P 3"], camera: Cameras, values: Float[Tensor, "H W"]
) -> tuple[Bool[Tensor, " P"], Float[Tensor, " L"]]:
    """Which points lie in a camera's image, and what is there."""
    places, depths = project(points, camera)
    size = torch.tensor(camera.size).to(places)
    inside = ((places >= 0) & (places < size)).all(dim=1) & (depths > 0)
    x, y = places[inside].long().unbind(1)
    return inside, values[y, x]


def _normals(
    points: Float[Tensor, "H W 3"], origin: Float[Tensor, "1 3"]
) -> tuple[Float[Tensor, "H W 3"], Bool[Tensor, "H W"]]:
    """Normals from neighbouring pixels, towards the camera; and where these lie side by side."""
    padded = F.pad(points.permute(2, 0, 1)[None], (1, 1, 1, 1), mode="replicate")[0]
    along = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    down = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    normals = F.normalize(torch.linalg.cross(along, down, dim=0), dim=0).permute(1, 2, 0)
    facing = (normals * F.normalize(origin - points, dim=2)).sum(dim=2)
    return normals * facing.sign()[..., None], facing.abs() > GRAZING

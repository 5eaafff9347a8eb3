"""Views of an object: cameras cropped to it, and the pixels and features that are its own."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say, track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import Contributions, contributions
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.shares import COVERED, contributed, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import SH_C0, Splats
from stylesplat.stylization.config import Stage
from stylesplat.stylization.features.network import Cells
from stylesplat.stylization.target import PaintContext, PaintTarget

SURVEY_SIZE = 160  # longer side of the renders that find boxes, in pixels
STRAY = 0.002  # share of the covered pixels that a box may leave out on each side
MARGIN = 12  # pixels around a box at most: farther ones move a deep feature by less than 1 %
MIN_CELLS = 16  # views with fewer features of the object are skipped
VISITS = 5  # steps per view at least: preparing a view takes as long as a step
VISITS_OF_WINDOWS = 2  # fewer, as it takes many windows to cover the object
MEBIBYTE = 2**20


@dataclass(frozen=True)
class Box:
    """Where an object lies in one camera's image."""

    camera: Cameras
    """One camera, at full size."""
    low: Float[Tensor, " 2"]
    """Left and top, in pixels."""
    high: Float[Tensor, " 2"]
    """Right and bottom, in pixels."""
    points: Float[Tensor, "P 2"]
    """Pixels that the object covers, evenly spread: x and y."""

    @property
    def length(self) -> float:
        """The longer side."""
        return float((self.high - self.low).max())


@dataclass(frozen=True)
class ObjectView:
    """A view cropped to an object and to what its features depend on."""

    camera: Cameras
    """One camera, whose image is the crop."""
    cells: tuple[Bool[Tensor, "_ _"], ...]
    """Which features are the object's, for each layer group."""
    pixels: Bool[Tensor, "H W"]
    """Which pixels are the object's."""
    linear: Contributions | None = None
    """The image as a function of the object's colours; None rasterises it every time."""

    def render(self, splats: Splats) -> Float[Tensor, "H W 3"]:
        """Render splats that differ from the scene at most in the object's colours."""
        if self.linear is not None:
            return self.linear.render(splats)
        return rasterize(splats, self.camera)[0][0]

    def weights(self, splats: Splats, mask: Bool[Tensor, " N"]) -> Float[Tensor, " N"]:
        """The contribution of each of the object's Gaussians, summed over the pixels."""
        if self.linear is not None:
            weights = splats.means.new_zeros(len(splats))
            return weights.index_copy_(0, self.linear.gaussians, self.linear.weights())
        width, height = self.camera.size
        everywhere = splats.means.new_ones(height, width, 1)
        return contributed(splats, self.camera, everywhere)[:, 0] * mask

    def backproject(self, splats: Splats, image: Float[Tensor, "H W 3"]) -> Float[Tensor, "N 1 3"]:
        """The transpose of rendering: an image times the weight of each Gaussian, summed."""
        with torch.enable_grad():
            grey = torch.zeros_like(splats.sh0).requires_grad_()
            (sums,) = torch.autograd.grad(self.render(replace(splats, sh0=grey)), grey, image)
        return sums / SH_C0


def with_fixed_bands(views: Sequence[ObjectView], splats: Splats) -> list[ObjectView]:
    """Views that are quicker, for splats that differ from these at most in `sh0`."""
    varied = splats.shN.flatten(1).any(dim=1)
    return [
        replace(view, linear=view.linear and view.linear.with_fixed_bands(splats, varied))
        for view in views
    ]


def total_weights(
    views: Sequence[ObjectView], splats: Splats, mask: Bool[Tensor, " N"]
) -> Float[Tensor, " M"]:
    """The contribution of each of the object's Gaussians, summed over all views."""
    weights = splats.means.new_zeros(len(splats))
    for view in views:
        weights += view.weights(splats, mask)
    return weights[mask]


def find_boxes(splats: Splats, cameras: Cameras, mask: Bool[Tensor, " N"]) -> list[Box]:
    """Find the views that show an object, and where; occlusion is taken into account."""

    def find(index: int) -> Box | None:
        camera = cameras[index]
        small = camera.at_most(SURVEY_SIZE)
        covered = coverage(splats, small, mask) > COVERED
        if not covered.any():
            return None
        ratio = camera.sizes[0] / small.sizes[0]
        pixels = covered.nonzero().flip(1).cpu()  # x, y
        few = int(STRAY * len(pixels))
        ordered = pixels.sort(dim=0).values
        low, high = ordered[few], ordered[len(ordered) - 1 - few] + 1
        return Box(camera, low * ratio, high * ratio, (pixels + 0.5) * ratio)

    found = at_once(find, range(len(cameras)), splats.device)
    found = track(found, "looking for the object", total=len(cameras))
    return [box for box in found if box is not None]


def boxes_in(boxes: Sequence[Box], cameras: Cameras) -> list[Box]:
    """The boxes that lie in some cameras, by the cameras' names."""
    names = {*cameras.names}
    return [box for box in boxes if box.camera.names[0] in names]


def typical_length(boxes: Sequence[Box]) -> float:
    """The median of the object's longer sides, in pixels."""
    return median(box.length for box in boxes)


def require_boxes(context: PaintContext, target: PaintTarget, cameras: Cameras) -> list[Box]:
    """Find the views that show the object.

    Raises:
        StyleSplatError: If no view shows it.
    """
    boxes = find_boxes(context.splats, cameras, target.mask)
    if not boxes:
        raise StyleSplatError(
            f"Cannot stylise {target.name}: it is seen in none of the {len(cameras)} views. "
            f"Pick other Gaussians, or show views of it."
        )
    return boxes


def object_views(
    context: PaintContext,
    target: PaintTarget,
    boxes: Sequence[Box],
    zoom: float,
    *,
    max_memory: float = 0.0,
) -> list[ObjectView]:
    """Views of the object at a multiple of the cameras' size.

    Args:
        context: The scene and the network.
        target: The object.
        boxes: Where it lies.
        zoom: Size of the views, as a multiple of the cameras'.
        max_memory: Bytes that linear views may take; others are rasterised in every step.

    Raises:
        StyleSplatError: If it is hardly visible in any.
    """
    cells = [context.network.cells(group) for group in target.config.layers]
    splats = context.splats
    views = crop_views(splats, boxes, target.mask, cells, zoom=zoom, max_memory=max_memory)
    if not views:
        raise StyleSplatError(
            f"Cannot stylise {target.name}: it is hardly visible in the {len(boxes)} views that "
            f"show it. Pick a larger object, or show closer views of it."
        )
    return views


def stage_views(
    context: PaintContext,
    target: PaintTarget,
    boxes: Sequence[Box],
    stage: Stage,
    generator: torch.Generator,
) -> list[ObjectView]:
    """The views or windows of a stage; a stage of few steps needs few of them.

    Raises:
        StyleSplatError: If the object is hardly visible in any.
    """
    zoom = stage.length / typical_length(boxes)
    if stage.window is None:
        boxes = evenly(boxes, math.ceil(stage.steps / VISITS))
    else:
        count = math.ceil(stage.steps / VISITS_OF_WINDOWS)
        boxes = windows(boxes, stage.window / zoom, count, generator)
    return object_views(context, target, boxes, zoom, max_memory=context.max_memory)


def windows(boxes: Sequence[Box], side: float, count: int, generator: torch.Generator) -> list[Box]:
    """Square windows in boxes, in random order and around random pixels of the object.

    Args:
        boxes: Each gives as many as the others.
        side: In pixels of the cameras; windows of smaller boxes are smaller.
        count: How many.
        generator: Draws the pixels.
    """
    found = []
    order = torch.randperm(count, generator=generator).tolist()
    for box in (boxes[index % len(boxes)] for index in order):
        point = box.points[int(torch.randint(len(box.points), (), generator=generator))]
        low = (point - side / 2).minimum(box.high - side).maximum(box.low)
        found.append(replace(box, low=low, high=box.high.minimum(low + side)))
    return found


def crop_views(
    splats: Splats,
    boxes: Sequence[Box],
    mask: Bool[Tensor, " N"],
    cells: Sequence[Cells],
    *,
    zoom: float,
    max_memory: float = 0.0,
) -> list[ObjectView]:
    """Crop views to an object and mark its features; skip views that hardly show it.

    Args:
        splats: The scene.
        boxes: Where the object lies.
        mask: The object's Gaussians.
        cells: Where the features of each layer group lie.
        zoom: Size of the views, as a multiple of the cameras'.
        max_memory: Bytes that linear views may take; others are rasterised in every step.
    """
    views, used, full = list[ObjectView](), 0, False
    # what features depend on around a box
    before, after = max(c.before for c in cells), max(c.size - c.before for c in cells)
    margins = min(MARGIN, before), min(MARGIN, after)
    is_linear = max_memory > 0 and splats.device.type == "cpu"

    def prepare(box: Box) -> tuple[Cameras, Tensor, Contributions | None]:
        camera, inside = crop_to_box(box, zoom, margins)
        kept = is_linear and not full
        return camera, inside, contributions(splats, camera, mask) if kept else None

    prepared = at_once(prepare, boxes, splats.device)
    for camera, inside, linear in track(prepared, "preparing the views", total=len(boxes)):
        linear = None if full else linear
        covered = linear.coverage if linear else coverage(splats, camera, mask)
        own = covered * inside.to(covered.device)
        masks = tuple(F.avg_pool2d(own[None], c.stride)[0] > COVERED for c in cells)
        if all(each.sum() >= MIN_CELLS for each in masks):
            used += linear.nbytes if linear else 0
            if used > max_memory:
                full, linear = True, None
            views.append(ObjectView(camera, masks, covered > COVERED, linear))
    if is_linear and full:
        kept = sum(view.linear is not None for view in views)
        say(
            f"{kept} of {len(views)} views fit into {max_memory / MEBIBYTE:.0f} MB; the others are "
            "rasterised in every step, which takes longer. Pass a larger max_memory to keep more."
        )
    return views


def crop_to_box(
    box: Box, zoom: float, margins: tuple[int, int]
) -> tuple[Cameras, Bool[Tensor, "H W"]]:
    """The camera of a box with some pixels around it, and the mask of the box's pixels.

    Args:
        box: Where an object lies.
        zoom: Size of the image, as a multiple of the camera's.
        margins: Pixels to the left and above, and to the right and below.
    """
    camera = box.camera.downscale(1 / zoom)
    inner = (box.low * zoom).floor(), (box.high * zoom).ceil()
    low, high = inner[0] - margins[0], inner[1] + margins[1]
    low, high = low.clamp(min=0).long(), torch.minimum(high, camera.sizes[0]).long()
    cropped = crop(camera, low.tolist(), (high - low).tolist())
    (left, top), (right, bottom) = ((corner - low).long().tolist() for corner in inner)
    inside = torch.zeros(cropped.size[::-1], dtype=torch.bool)
    inside[top:bottom, left:right] = True
    return cropped, inside

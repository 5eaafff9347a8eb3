"""Where an object is seen: cameras cut to it, and the features that are its own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.progress import say, track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import Contributions, contributions
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.sh import SH_C0
from stylesplat.rendering.shares import COVERED, contributed, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import Cells

SURVEY_SIZE = 160  # longer side of the renders in which objects are looked for
STRAY = 0.002  # share of the covered pixels that a box may leave out on each side
MARGIN = 12  # pixels around a box at most: what lies beyond hardly moves a deep feature (< 1 %)
MEBIBYTE = 2**20
HIDDEN = 1e-3  # pixels that a Gaussian paints in all views: fewer tell no colour
MIN_CELLS = 16  # views that show fewer features of the object are skipped


@dataclass(frozen=True)
class Box:
    """Where an object lies in one camera's image."""

    camera: Cameras
    """The camera alone, at full size."""
    low: Float[Tensor, " 2"]
    """Left and top, in pixels."""
    high: Float[Tensor, " 2"]
    """Right and bottom."""
    places: Float[Tensor, "P 2"]
    """Where it covers the image, evenly: x and y."""

    @property
    def length(self) -> float:
        """The longer side."""
        return float((self.high - self.low).max())


@dataclass(frozen=True)
class ObjectView:
    """A view of an object, cut to what its features depend on."""

    camera: Cameras
    """One camera, whose image is the cut."""
    cells: tuple[Bool[Tensor, "_ _"], ...]
    """For each block of features, which of them are the object's."""
    pixels: Bool[Tensor, "H W"]
    """Which pixels are the object's."""
    linear: Contributions | None = None
    """The image as a function of the object's colours; None if it is rasterised every time."""

    def render(self, splats: Splats) -> Float[Tensor, "H W 3"]:
        """The view of splats that differ from the scene at most in the object's colours."""
        if self.linear is not None:
            return self.linear.render(splats)
        return rasterize(splats, self.camera)[0][0]

    def weights(self, splats: Splats, picked: Bool[Tensor, " N"]) -> Float[Tensor, " N"]:
        """What each picked Gaussian contributes to the view, summed over its pixels."""
        if self.linear is not None:
            weights = splats.means.new_zeros(len(splats))
            return weights.index_copy_(0, self.linear.gaussians, self.linear.weights())
        width, height = self.camera.size
        everywhere = splats.means.new_ones(height, width, 1)
        return contributed(splats, self.camera, everywhere)[:, 0] * picked

    def carried(self, splats: Splats, image: Float[Tensor, "H W 3"]) -> Float[Tensor, "N 1 3"]:
        """What each of the object's Gaussians paints of an image, summed over its pixels.

        A render is linear in what Gaussians carry.
        """
        with torch.enable_grad():
            grey = torch.zeros_like(splats.sh0).requires_grad_()
            (sums,) = torch.autograd.grad(self.render(replace(splats, sh0=grey)), grey, image)
        return sums / SH_C0

    def with_fixed_bands(
        self, splats: Splats, varied: Bool[Tensor, " N"] | None = None
    ) -> "ObjectView":
        """As `Contributions.with_fixed_bands`, where it has contributions."""
        linear = self.linear and self.linear.with_fixed_bands(splats, varied)
        return replace(self, linear=linear)


def with_fixed_bands(views: Sequence[ObjectView], splats: Splats) -> list[ObjectView]:
    """Views for splats that differ from these at most in `sh0`: quicker."""
    varied = splats.shN.flatten(1).any(dim=1)
    return [view.with_fixed_bands(splats, varied) for view in views]


def weights_in(
    views: Sequence[ObjectView], splats: Splats, picked: Bool[Tensor, " N"]
) -> Float[Tensor, " M"]:
    """What each picked Gaussian contributes to all of some views, summed over their pixels."""
    weights = splats.means.new_zeros(len(splats))
    for view in views:
        weights += view.weights(splats, picked)
    return weights[picked]


def find_boxes(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> list[Box]:
    """Find in which views an object shows, and where; what hides it is taken into account."""

    def find(index: int) -> Box | None:
        camera = cameras[index]
        small = camera.at_most(SURVEY_SIZE)
        covered = coverage(splats, small, picked) > COVERED
        if not covered.any():
            return None
        ratio = camera.sizes[0] / small.sizes[0]
        low, high = _extent(covered)
        places = covered.nonzero().flip(1).cpu() + 0.5
        return Box(camera, low * ratio, high * ratio, places * ratio)

    found = at_once(find, range(len(cameras)), splats.device)
    found = track(found, "looking for the object", total=len(cameras))
    return [box for box in found if box is not None]


def boxes_in(boxes: Sequence[Box], cameras: Cameras) -> list[Box]:
    """The boxes that lie in some cameras, by their names."""
    names = {*cameras.names}
    return [box for box in boxes if box.camera.names[0] in names]


def _extent(covered: Bool[Tensor, "H W"]) -> tuple[Tensor, Tensor]:
    """Left, top and right, bottom of nearly all that is covered; strays are left outside."""
    pixels = covered.nonzero().flip(1).cpu()  # x, y
    few = int(STRAY * len(pixels))
    ordered = pixels.sort(dim=0).values
    return ordered[few], ordered[len(ordered) - 1 - few] + 1


def windows(boxes: Sequence[Box], side: float, count: int, generator: torch.Generator) -> list[Box]:
    """Square parts of boxes, in random order and around random places that the object covers.

    Args:
        boxes: Each gives as many as the others.
        side: In pixels of the cameras, at most; parts of smaller boxes are smaller.
        count: How many.
        generator: Draws the places.
    """
    drawn = []
    order = torch.randperm(count, generator=generator).tolist()
    for box in (boxes[index % len(boxes)] for index in order):
        place = box.places[int(torch.randint(len(box.places), (), generator=generator))]
        low = (place - side / 2).minimum(box.high - side).maximum(box.low)
        drawn.append(replace(box, low=low, high=box.high.minimum(low + side)))
    return drawn


def typical_length(boxes: Sequence[Box]) -> float:
    """The median of the object's longer sides."""
    return median(box.length for box in boxes)


def cut_views(
    splats: Splats,
    boxes: Sequence[Box],
    picked: Bool[Tensor, " N"],
    cells: Sequence[Cells],
    *,
    zoom: float,
    max_memory: float = 0.0,
) -> list[ObjectView]:
    """Cut views to an object and mark its features; skip those where it hardly shows.

    Args:
        splats: The scene.
        boxes: Where the object lies.
        picked: The object's Gaussians.
        cells: Where the features of each block lie.
        zoom: Size of the views, as a multiple of the cameras'.
        max_memory: Bytes that linear views may take; what does not fit is rasterised each time.
    """
    views, used, full = [], 0, False
    # what features depend on around a box
    before, after = max(c.before for c in cells), max(c.size - c.before for c in cells)
    margins = min(MARGIN, before), min(MARGIN, after)
    keeps = max_memory > 0 and splats.device.type == "cpu"

    def cut(box: Box) -> tuple[Cameras, Tensor, Contributions | None]:
        camera, inside = around(box, zoom, margins)
        return camera, inside, contributions(splats, camera, picked) if keeps and not full else None

    cuts = at_once(cut, boxes, splats.device)
    for camera, inside, linear in track(cuts, "cutting the views", total=len(boxes)):
        linear = None if full else linear  # of one that was cut before it was known
        seen = linear.coverage if linear else coverage(splats, camera, picked)
        own = seen * inside.to(seen.device)
        masks = tuple(F.avg_pool2d(own[None], c.stride)[0] > COVERED for c in cells)
        if all(mask.sum() >= MIN_CELLS for mask in masks):
            used += linear.nbytes if linear else 0
            if used > max_memory:
                full, linear = True, None
            views.append(ObjectView(camera, masks, seen > COVERED, linear))
    if keeps and full:
        _say_full(views, max_memory)
    return views


def _say_full(views: Sequence[ObjectView], max_memory: float) -> None:
    kept = sum(view.linear is not None for view in views)
    say(
        f"{kept} of {len(views)} views fit into {max_memory / MEBIBYTE:.0f} MB; the others are "
        "rasterised in every step, which takes longer. Raise --max-memory to keep more."
    )


def around(box: Box, zoom: float, margins: tuple[int, int]) -> tuple[Cameras, Bool[Tensor, "H W"]]:
    """The camera of a box and of some pixels around it, and which pixels are the box's.

    Args:
        box: Where an object lies.
        zoom: Size of the image, as a multiple of the camera's.
        margins: Pixels to the left and above, and to the right and below.
    """
    camera = box.camera.downscale(1 / zoom)
    inner = (box.low * zoom).floor(), (box.high * zoom).ceil()
    low, high = inner[0] - margins[0], inner[1] + margins[1]
    low, high = low.clamp(min=0).long(), torch.minimum(high, camera.sizes[0]).long()
    cut = crop(camera, low.tolist(), (high - low).tolist())
    (left, top), (right, bottom) = ((place - low).long().tolist() for place in inner)
    inside = torch.zeros(cut.size[::-1], dtype=torch.bool)
    inside[top:bottom, left:right] = True
    return cut, inside

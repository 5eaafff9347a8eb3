"""Views of an object: cameras cropped to it, and the pixels and features that are its own."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import (
    COVERED,
    Contributions,
    backproject,
    contributions,
    coverage,
    geometry_only,
    pixels_in,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import project
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.stylization.config import Stage
from stylesplat.stylization.painting import Painting, PaintSetup

SURVEY_SIZE = 160  # longer side of the renders that find boxes, in pixels
BOX_STRAY = 0.002  # share of the covered pixels that a box may leave out on each side
SHOWN_PLACES = 4096  # Gaussians of the object, at random, by which views are compared
SHOWN_ENOUGH = 0.5  # of the pixels in the view that shows a Gaussian largest: more adds nothing
SHOWN_MORE = 0.002  # of the object, which a further view is to show
BOX_MARGIN = 12  # pixels around a box at most: farther ones move a deep feature by less than 1 %
MIN_CELLS = 16  # views with fewer features of the object are skipped
VISITS = 5  # steps per view at equal distances: preparing a view takes as long as a step
VISITS_OF_WINDOWS = 2  # fewer, as it takes many windows to cover the object
WINDOW_PLACES = 4096  # of a surface, which windows are to show
WINDOW_FACING = 0.5  # of the largest cosine at which a view sees a place, from which it shows it
SIGHT_CELLS = 32  # of a view's longer side, in each of which the nearest place hides farther ones
WHOLE_VIEWS = 8  # of the whole object, which tell its colours and its form
WHOLE_LENGTH = 240.0  # longer side of the object in them at most, in pixels
MEBIBYTE = 2**20

Surface = tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]
"""Places all over an object, evenly spread, and the normals there."""


@dataclass(frozen=True, eq=False)
class ObjectBox:
    """Where an object lies in one camera's image, at full size: x and y, in pixels."""

    camera: Cameras
    low: Float[Tensor, " 2"]
    high: Float[Tensor, " 2"]
    points: Float[Tensor, "P 2"]
    """Pixels that the object covers, evenly spread."""
    shows: Float[Tensor, " S"]
    """Pixels of some of the object's Gaussians, which are the same in all boxes."""

    @property
    def length(self) -> float:
        """The longer side."""
        return float((self.high - self.low).max())


@dataclass(frozen=True, eq=False)
class PaintView:
    """A view cropped to an object and to what its features depend on."""

    camera: Cameras
    """One camera, whose image is the crop."""
    cells: Bool[Tensor, "_ _"]
    """Which features are the object's."""
    pixels: Bool[Tensor, "H W"]
    """Those of the object."""

    def render(self, colors: Float[Tensor, "P 3"]) -> Float[Tensor, "H W 3"]:
        """The image when the object's points have these colours, as coefficients of sh0."""
        raise NotImplementedError

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "P D"]:
        """The sum of an image times the weights of each point."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class ObjectView(PaintView):
    """A view of Gaussians of a scene. They look the same from everywhere."""

    scene: Splats
    rows: Int[Tensor, " P"]
    """The object's Gaussians."""
    linear: Contributions | None = None
    """The image as a function of their colours; None rasterises the scene every time."""

    def render(self, colors: Float[Tensor, "P 3"]) -> Float[Tensor, "H W 3"]:
        """See `PaintView`."""
        if self.linear is not None:
            own = colors.index_select(0, self.linear.gaussians)
            return self.linear.render(rgb_from_sh0(own).relu())
        matte = colors.new_zeros(len(colors), *self.scene.shN.shape[1:])
        bands = {"sh0": colors[:, None], "shN": matte}
        return rasterize(self.scene.with_rows(self.rows, bands), self.camera)[0][0]

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "P D"]:
        """See `PaintView`."""
        if self.linear is None:
            return backproject(self.scene, self.camera, image)[self.rows]
        sums = image.new_zeros(len(self.rows), image.shape[-1])
        return sums.index_add_(0, self.linear.gaussians, self.linear.backproject(image))


def total_weights(views: Sequence[PaintView]) -> Float[Tensor, " P"]:
    """The contribution of each of the object's points, summed over all views."""
    every = (view.backproject(torch.ones_like(view.pixels[..., None]).float()) for view in views)
    return sum(every, torch.zeros(()))[:, 0]


def find_boxes(splats: Splats, cameras: Cameras, mask: Bool[Tensor, " N"]) -> list[ObjectBox]:
    """Find the views that show an object, and where.

    Views with longer sides than the median are shrunk to it: that a photo has many pixels does not
    mean that the object is close.
    """
    side = int(cameras.sizes.amax(dim=1).median())
    bare, rows = geometry_only(splats), mask.nonzero()[:, 0]
    order = torch.randperm(len(rows), generator=torch.Generator().manual_seed(0))
    places = rows[order[:SHOWN_PLACES].to(rows.device)]

    def find(index: int) -> ObjectBox | None:
        camera = cameras[index].at_most(side)
        small = camera.at_most(SURVEY_SIZE)
        covered = coverage(bare, small, mask) > COVERED
        if not covered.any():
            return None
        ratio = camera.sizes[0] / small.sizes[0]
        shown = pixels_in(bare, [small], [covered])[places].cpu() * ratio.prod()
        pixels = covered.nonzero().flip(1).cpu()  # x, y
        few = int(BOX_STRAY * len(pixels))
        ordered = pixels.sort(dim=0).values
        low, high = ordered[few], ordered[len(ordered) - 1 - few] + 1
        return ObjectBox(camera, low * ratio, high * ratio, (pixels + 0.5) * ratio, shown)

    found = per_view(find, range(len(cameras)), "looking for the object", splats.device)
    return [box for box in found if box is not None]


def views_all_over(boxes: Sequence[ObjectBox], count: int) -> list[ObjectBox]:
    """`count` boxes at equal distances, and at most as many that show much of what these do not.

    Views at equal distances are not enough where a video lingers at one side. The others are those
    that add most, one after another.
    """
    chosen = evenly_spaced(range(len(boxes)), count)
    if len(chosen) == len(boxes):
        return list(boxes)
    shown = torch.stack([box.shows for box in boxes])
    shares = (shown / shown.amax(dim=0).clamp(min=1e-6)).clamp(max=SHOWN_ENOUGH) / SHOWN_ENOUGH
    best = shares[chosen].amax(dim=0)
    while len(chosen) < min(2 * count, len(boxes)):
        gains = (shares - best).clamp(min=0).mean(dim=1)
        if gains.max() < SHOWN_MORE:
            break
        chosen.append(int(gains.argmax()))
        best = best.maximum(shares[chosen[-1]])
    return [boxes[row] for row in sorted(chosen)]


def typical_length(boxes: Sequence[ObjectBox]) -> float:
    return median(box.length for box in boxes)


def require_boxes(setup: PaintSetup, painting: Painting) -> list[ObjectBox]:
    """Find the views to optimise on that show the object; refuse it if none does."""
    boxes = find_boxes(setup.splats, setup.cameras, painting.mask)
    if not boxes:
        raise StyleSplatError(
            f"Cannot stylise {painting.name}: it is seen in none of the {len(setup.cameras)} "
            f"views. Pick other Gaussians, or show views of it."
        )
    return boxes


def object_views(
    setup: PaintSetup,
    painting: Painting,
    boxes: Sequence[ObjectBox],
    zoom: float,
    *,
    max_memory: float = 0.0,
    others: Sequence[ObjectBox] = (),
) -> list[ObjectView]:
    """Views cropped to boxes of the object, at a multiple of the cameras' size.

    Boxes that hardly show it are skipped; where all of them do, `others` take their place. Linear
    views may take so many bytes of memory; more are rasterised in every step.
    """
    splats, mask = setup.splats, painting.mask
    cells = setup.network.cells(painting.config.block)
    views, used, full = list[ObjectView](), 0, False
    # what features depend on around a box
    margins = min(BOX_MARGIN, cells.before), min(BOX_MARGIN, cells.size - cells.before)
    is_linear = max_memory > 0
    rows, places = mask.nonzero()[:, 0], mask.cumsum(dim=0) - 1

    def prepare(box: ObjectBox) -> tuple[Cameras, Tensor, Contributions | None]:
        camera, inside = crop_to_box(box, zoom, margins)
        camera = camera.to(splats.device)  # not in every step
        kept = is_linear and not full
        return camera, inside, contributions(splats, camera, mask) if kept else None

    prepared = per_view(prepare, boxes, "preparing the views", splats.device)
    for camera, inside, linear in prepared:
        linear = None if full else linear
        covered = linear.coverage if linear else coverage(splats, camera, mask)
        own = covered * inside.to(covered.device)
        own_cells = F.avg_pool2d(own[None], cells.stride)[0] > COVERED
        if own_cells.sum() >= MIN_CELLS:
            used += linear.nbytes if linear else 0
            full = used > max_memory
            linear = None if full else linear
            own = covered > COVERED
            if linear is not None:  # the object's Gaussians alone count
                linear = replace(linear, count=len(rows), gaussians=places[linear.gaussians])
            views.append(ObjectView(camera, own_cells, own, splats, rows, linear))
    if not views and others:
        return object_views(setup, painting, others, zoom, max_memory=max_memory)
    if not views:
        raise StyleSplatError(
            f"Cannot stylise {painting.name}: it is hardly visible in the {len(boxes)} views that "
            f"show it. Pick a larger object, or show closer views of it."
        )
    if is_linear and full:
        kept = sum(view.linear is not None for view in views)
        say(
            f"{kept} of {len(views)} views fit into {max_memory / MEBIBYTE:.0f} MB; the others are "
            "rasterised in every step, which takes longer. Pass a larger max_memory to keep more."
        )
    return views


def stage_views(
    setup: PaintSetup,
    painting: Painting,
    boxes: Sequence[ObjectBox],
    stage: Stage,
    generator: torch.Generator,
    surface: Surface | None = None,
) -> list[ObjectView]:
    """The views or windows of a stage; a stage of few steps needs few of them."""
    zoom = stage.length / typical_length(boxes)
    if stage.window is None:
        few = views_all_over(boxes, math.ceil(stage.steps / VISITS))
    else:
        count = math.ceil(stage.steps / VISITS_OF_WINDOWS)
        few = windows(boxes, stage.window / zoom, count, generator, surface)
    return object_views(setup, painting, few, zoom, max_memory=setup.max_memory, others=boxes)


def whole_views(
    setup: PaintSetup,
    painting: Painting,
    boxes: Sequence[ObjectBox],
    stage: Stage,
    least: int,
    views: Sequence[ObjectView] = (),
) -> tuple[list[ObjectView], float]:
    """A few views of the whole object, and how long it is in them, in pixels.

    They are a stage's, which are made if they are not given, unless these are windows or fewer than
    `least`.
    """
    if stage.window is None:
        views = views or stage_views(setup, painting, boxes, stage, torch.Generator())
        if len(views) >= least:
            return evenly_spaced(views, WHOLE_VIEWS), stage.length
    length = min(stage.length, WHOLE_LENGTH)
    few, zoom = views_all_over(boxes, WHOLE_VIEWS), length / typical_length(boxes)
    views = object_views(setup, painting, few, zoom, max_memory=math.inf, others=boxes)
    return views, length


def windows(
    boxes: Sequence[ObjectBox],
    side: float,
    count: int,
    generator: torch.Generator,
    surface: Surface | None = None,
) -> list[ObjectBox]:
    """Square windows in boxes around random pixels of the object, equally many in each box.

    With its surface each is around the place that those before show least, in the view of those
    that it faces which shows most that is new.
    """
    if surface is not None:
        return _windows_all_over(boxes, side, count, generator, surface)
    found = []
    for index in torch.randperm(count, generator=generator).tolist():
        box = boxes[index % len(boxes)]
        point = box.points[int(torch.randint(len(box.points), (), generator=generator))]
        found.append(_window(box, point, side))
    return found


def _window(box: ObjectBox, point: Float[Tensor, " 2"], side: float) -> ObjectBox:
    """A window in a box, around a point if there is room."""
    low = (point - side / 2).minimum(box.high - side).maximum(box.low)
    return replace(box, low=low, high=box.high.minimum(low + side))


def _windows_all_over(
    boxes: Sequence[ObjectBox],
    side: float,
    count: int,
    generator: torch.Generator,
    surface: Surface,
) -> list[ObjectBox]:
    """See `windows`: random places leave some that no window shows, which stay without strokes."""
    some = torch.randperm(len(surface[0]), generator=generator)[:WINDOW_PLACES]
    places, normals = (each[some.to(each.device)].cpu() for each in surface)
    seen = [_sight(box, places, normals) for box in boxes]
    pixels, sight = (torch.stack(each) for each in zip(*seen, strict=True))
    if not sight.any():
        return windows(boxes, side, count, generator)
    sight = sight / sight.amax(dim=0).clamp(min=1e-6)  # of each place's best view
    shown = torch.rand(len(places), generator=generator) / 2  # which of two alike comes first
    shown[~sight.any(dim=0)] = torch.inf
    found = []
    for _ in range(count):
        place = int(shown.argmin())
        is_fresh, options = shown < shown[place] + 1, list[tuple[ObjectBox, Tensor]]()
        for row in (sight[:, place] >= WINDOW_FACING).nonzero()[:, 0].tolist():
            window = _window(boxes[row], pixels[row, place], side)
            inside = ((pixels[row] >= window.low) & (pixels[row] < window.high)).all(dim=1)
            options.append((window, inside * sight[row]))
        window, shows = max(options, key=lambda option: float((option[1] * is_fresh).sum()))
        shown += shows
        found.append(window)
    return found


def _sight(
    box: ObjectBox, places: Float[Tensor, "P 3"], normals: Float[Tensor, "P 3"]
) -> tuple[Float[Tensor, "P 2"], Float[Tensor, " P"]]:
    """Where places are in a view, and the cosines at which it sees them; 0 where others hide it."""
    pixels, depths = project(places, box.camera)
    facing = (normals * F.normalize(box.camera.positions - places, dim=1)).sum(dim=1)
    inside = ((pixels >= box.low) & (pixels < box.high)).all(dim=1) & (depths > 0)
    cell = box.length / SIGHT_CELLS
    x, y = ((pixels - box.low) / cell).clamp(0, SIGHT_CELLS - 1).long().unbind(dim=1)
    depths = torch.where(inside, depths, torch.inf)
    nearest = depths.new_full((SIGHT_CELLS**2,), torch.inf)
    nearest = nearest.scatter_reduce(0, y * SIGHT_CELLS + x, depths, "amin")
    behind = depths - nearest[y * SIGHT_CELLS + x]
    far = 2 * cell * depths / box.camera.Ks[0, 0, 0]  # of a cell's width, which slants change
    return pixels, facing.clamp(min=0) * inside * (behind < far)


def crop_to_box(
    box: ObjectBox, zoom: float, margins: tuple[int, int]
) -> tuple[Cameras, Bool[Tensor, "H W"]]:
    """The camera of a box, with margins before and behind, and the mask of the box's pixels."""
    camera = box.camera.downscale(1 / zoom)
    inner = (box.low * zoom).floor(), (box.high * zoom).ceil()
    low, high = inner[0] - margins[0], inner[1] + margins[1]
    low, high = low.clamp(min=0).long(), torch.minimum(high, camera.sizes[0]).long()
    cropped = camera.crop(low.tolist(), (high - low).tolist())
    (left, top), (right, bottom) = ((corner - low).long().tolist() for corner in inner)
    inside = torch.zeros(cropped.size[::-1], dtype=torch.bool)
    inside[top:bottom, left:right] = True
    return cropped, inside


def box_cameras(
    boxes: Sequence[ObjectBox], length: float, count: int, margin: int = 1
) -> list[Cameras]:
    """Cameras cropped to `views_all_over`, in which the object is this long, in pixels."""
    zoom = length / typical_length(boxes)
    return [crop_to_box(box, zoom, (margin, margin))[0] for box in views_all_over(boxes, count)]


def reached_pixels(splats: Splats, camera: Cameras) -> Bool[Tensor, "H W"]:
    """The pixels in which some Gaussians would show if there were no others."""
    return coverage(geometry_only(splats), camera) > 0

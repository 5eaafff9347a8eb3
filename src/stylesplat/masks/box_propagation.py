"""From boxes around an object in a few photos to its masks in all photos, by way of a splat.

No one way to cut an object out of a splat suits all. What masks show, completed on the surface,
ends well where objects stand on a plane; a click follows folds, and needs no exact mask (one box
around the fox gives an IoU of .82 by its mask, and .95 by a click). What is small or badly known is
no set of patches at all, but masks that spread from view to view find it. The one is taken
that agrees best with the boxes and is an object: something farther shows around it from elsewhere.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import repeat

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks.contours import ColorLevels, move_to_edges, window_around
from stylesplat.masks.grabcut import (
    Channels,
    DrawnBox,
    GrabCutImage,
    color_levels,
    cut_box,
    grabcut_image,
    pixels_inside,
    refine_mask,
)
from stylesplat.progress import say, task
from stylesplat.rendering.weights import COVERED, PRIOR, composite, coverage, pixels_in
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, Mask
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import Splats
from stylesplat.selection.surface_cut import occluding_share, pick_clicked, pick_masked
from stylesplat.selection.surface_graph import NothingToPick

BOX_WEIGHT = 2.0  # of the IoU with a box, which a person drew, beside that with a cut
MOSTLY = 0.5  # share of a Gaussian's pixels in masks, from which they show it


ViewMask = Bool[Tensor, "_ _"]
"""A mask in one of several views, whose sizes may differ."""
BoxMasks = Mapping[int, ViewMask]
"""By row of a view what is inside of the box there."""


def pick_in_boxes(
    splats: Splats, cameras: Cameras, boxes: BoxMasks, cuts: Mapping[int, ViewMask]
) -> tuple[Bool[Tensor, " N"], float]:
    """The Gaussians of an object that boxes hold, as GrabCut's `cuts` do, and how well they agree.

    The splat is on the CPU.
    """
    picks = [*_candidates(splats, cameras, boxes, cuts)]
    scores = [agreement(splats, cameras, boxes, cuts, pick) for pick in picks]
    best = max(scores)
    return picks[scores.index(best)], best


def agreement(
    splats: Splats,
    cameras: Cameras,
    boxes: BoxMasks,
    cuts: Mapping[int, ViewMask],
    picked: Bool[Tensor, " N"],
) -> float:
    """Agreement of Gaussians with boxes and cuts, doubled if all outlines are an object's."""
    found = 0.0
    for row, box in boxes.items():
        shown = coverage(splats, cameras[row], picked) > COVERED
        found += BOX_WEIGHT * mask_iou(_bounding_box(shown), box)
        found += mask_iou(shown, cuts[row])
    return found * (1 + occluding_share(splats, cameras, picked))


def _candidates(
    splats: Splats, cameras: Cameras, boxes: BoxMasks, cuts: Mapping[int, ViewMask]
) -> Iterator[Bool[Tensor, " N"]]:
    """All there is, what cuts show, completed on the surface, and what clicks into them pick.

    All there is can be an object only where photos are cut out to it, so that most of what is
    beside the boxes is empty. Elsewhere the first candidate is nothing.
    """
    everything = torch.ones(len(splats), dtype=torch.bool)
    beside = [
        coverage(splats, cameras[row], everything)[~box] > COVERED for row, box in boxes.items()
    ]
    yield everything & (torch.cat(beside).float().mean() < MOSTLY)
    with suppress(NothingToPick):  # hardly any Gaussian shows
        yield pick_masked(splats, cameras, [(row, cuts[row], ~box) for row, box in boxes.items()])
    with suppress(NothingToPick):
        clicks = [(cameras[row], _deepest_pixel(cuts[row])) for row in boxes]
        yield pick_clicked(splats, cameras, clicks)


def _deepest_pixel(mask: Mask) -> tuple[float, float]:
    """The pixel that is farthest from what a mask leaves out, and from the photo's edges."""
    depth = np.asarray(distance_transform_edt(np.pad(mask.numpy(), 1)))[1:-1, 1:-1]
    y, x = np.unravel_index(depth.argmax(), depth.shape)
    return x + 0.5, y + 0.5


def _bounding_box(mask: Mask) -> Mask:
    """The smallest box around a mask."""
    box = torch.zeros_like(mask)
    if mask.any():
        box[window_around(mask.numpy(), 0)] = True
    return box


# Measured by IoU from one box: without settling two small objects of a desk fall from .77 and .79
# to .61, without new surfaces one to .70; one round of contours costs two of the demo .009
BOX_GROWTH = 2  # factor between the numbers of masked views before and after a round
SETTLING_ROUNDS = 2  # over all views at most, after each has a mask
SETTLED = 0.98  # mean IoU with the round before, at which they stop
CONTOUR_ROUNDS = 5  # of moving contours to edges, at most
CONTOURS_SETTLED = 0.998  # mean IoU with the round before, at which they stop
BOX_CLOSER = 2.0  # times more pixels than in any known view, from which a surface is new
MIN_SHOWN = 0.5  # pixels that a Gaussian makes up, from which marks and masks can mean it
# Share of a Gaussian's pixels in masks, from which it belongs to an object that is rendered again:
# with .5 the lowest tenth of the fox has an IoU of .89, with .4 .91; renders then grow too wide.
MIN_SHARE = 0.4
BOX_MIN_ALPHA = 0.05  # coverage of a pixel, below which its depth means nothing


@dataclass(frozen=True)
class Images:
    """What views show, by row; made on access and kept."""

    colors: Callable[[int], ColorLevels]
    with_depth: Callable[[int], GrabCutImage]


def view_images(splats: Splats, capture: Capture) -> Images:
    @cache
    def colors(row: int) -> ColorLevels:
        return color_levels(capture.photos[row])

    @cache
    @torch.no_grad()
    def with_depth(row: int) -> GrabCutImage:
        camera = capture.cameras[row]
        depths = depths_of(splats.means, camera)
        inverse = 1 / depths.clamp(min=1e-6 * float(depths.abs().max()))
        values = torch.stack([inverse, torch.ones_like(inverse)], dim=1)
        summed, alphas = composite(splats, camera, values).cpu().unbind(dim=-1)
        return grabcut_image(colors(row), summed / alphas.clamp(min=BOX_MIN_ALPHA))

    return Images(colors, with_depth)


@dataclass(frozen=True, eq=False)
class MaskVotes:
    """What the masks of some views say about each Gaussian."""

    rows: frozenset[int]
    votes: Float[Tensor, "N 2"]
    """Its pixels within the masks, and outside."""
    closest: Float[Tensor, " N"]
    """Its pixels in the view that shows it best."""

    @property
    def share(self) -> Float[Tensor, " N"]:
        """How likely each Gaussian belongs to the object; 0 where no view shows it."""
        return self.votes[:, 0] / (self.votes.sum(dim=1) + PRIOR)

    def picked(self, share: float) -> Bool[Tensor, " N"]:
        """The Gaussians that show, and have more than a share of their pixels in the masks."""
        return (self.votes.sum(dim=1) > MIN_SHOWN) & (self.share > share)

    def merged(self, other: "MaskVotes") -> "MaskVotes":
        closest = torch.maximum(self.closest, other.closest)
        return MaskVotes(self.rows | other.rows, self.votes + other.votes, closest)


def lift_masks(splats: Splats, cameras: Cameras, masks: Mapping[int, ViewMask]) -> MaskVotes:
    """The votes of masks, given by the row of their view."""
    votes = splats.means.new_zeros(len(splats), 2)
    closest = splats.means.new_zeros(len(splats))
    for row, mask in masks.items():
        pixels = pixels_in(splats, cameras[row], [torch.stack([mask, ~mask], dim=-1)])
        votes += pixels
        closest = torch.maximum(closest, pixels.sum(dim=1))
    return MaskVotes(frozenset(masks), votes, closest)


def render_votes(
    splats: Splats, cameras: Cameras, votes: MaskVotes, row: int
) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The probability of the object in a view, and the share of surfaces that are new there."""
    new = torch.zeros_like(votes.closest)
    if row not in votes.rows:
        width, height = cameras[row].size
        everywhere = pixels_in(splats, cameras[row], [torch.ones(height, width)])
        new += everywhere > BOX_CLOSER * votes.closest
    image = composite(splats, cameras[row], torch.stack([votes.share, new], dim=1))
    probability, novelty = image.clamp(0, 1).cpu().unbind(dim=-1)
    return probability, novelty


@torch.no_grad()
def propagate_boxes(
    splats: Splats,
    cameras: Cameras,
    images: Images,
    boxes: Sequence[tuple[int, DrawnBox]],
    marks: Sequence[tuple[int, ViewMask, ViewMask]] = (),
    *,
    name: str = "object",
) -> list[ViewMask]:
    """The masks of an object in every view, from boxes around it in one or a few.

    GrabCut segments there. What it finds is completed and bounded on the surface of the splat,
    without the plane that the object stands on. If that agrees with the boxes, its renders are the
    masks, with contours moved to edges. Otherwise the masks are lifted onto the Gaussians,
    rendered into the nearest other views and their contours moved to edges; then the next views,
    until all have one; then all again until they settle.

    Boxes are by row of view, in its pixels; `marks` are rows, their pixels that belong to the
    object, and that do not. A mask is empty where the object does not show.
    """
    cuts = {}
    for row, box in boxes:
        known_pixels = [(own, others) for at, own, others in marks if at == row]
        cuts[row] = cut_box(images.with_depth(row), box, cameras.names[row], known_pixels)
    known = {row: mask for row, (_, mask) in cuts.items()}
    channels = cuts[boxes[0][0]][0]
    on_cpu = splats.to("cpu")
    box_masks = {row: torch.from_numpy(pixels_inside(box, cameras[row].size)) for row, box in boxes}
    picked, best = pick_in_boxes(on_cpu, cameras, box_masks, known)

    def agrees_better(masks: Mapping[int, ViewMask]) -> bool:
        lifted = lift_masks(on_cpu, cameras, masks).picked(MOSTLY)
        return agreement(on_cpu, cameras, box_masks, known, lifted) > best

    if agrees_better(known):
        masks = _spread_masks(splats, cameras, images, known, channels, name)
        if agrees_better(dict(enumerate(masks))):
            return masks
    return _masks_at_edges(splats, cameras, images, picked.to(splats.device), name)


def _spread_masks(
    splats: Splats,
    cameras: Cameras,
    images: Images,
    cuts: Mapping[int, ViewMask],
    channels: Channels,
    name: str,
) -> list[ViewMask]:
    """The masks of an object in every view, from those in some, to the nearest views first."""
    known = dict(cuts)
    others, votes = nearest_views(cameras, [*known]), lift_masks(splats, cameras, known)
    rounds = 1 + SETTLING_ROUNDS
    with task(f"spreading the mask of {name!r}", rounds * len(others), unit="view") as bar:

        def refine_views(rows: Sequence[int]) -> dict[int, ViewMask]:
            return _refine_views(splats, cameras, images, votes, rows, channels, bar.advance)

        start = 0
        while start < len(others):
            found = refine_views(others[start : start + max(1, (BOX_GROWTH - 1) * len(known))])
            known |= found
            votes = votes.merged(lift_masks(splats, cameras, found))
            start += len(found)
        for left in reversed(range(SETTLING_ROUNDS)):
            again = refine_views(others)
            overlap = [mask_iou(known[row], mask) for row, mask in again.items()]
            known |= again
            if sum(overlap) >= SETTLED * len(overlap):
                bar.advance(left * len(others))
                break
            votes = lift_masks(splats, cameras, known)
    return [known[row] for row in range(len(cameras))]


def _masks_at_edges(
    splats: Splats, cameras: Cameras, images: Images, picked: Bool[Tensor, " N"], name: str
) -> list[ViewMask]:
    """The masks of picked Gaussians, whose contours lie at edges of photos.

    Masks are lifted, so that views agree on them, rendered, and their contours moved again, until
    they stay. In several rounds thin legs grow to their ends.
    """
    rows, masks = range(len(cameras)), list[ViewMask]()
    steps = CONTOUR_ROUNDS * len(rows)
    with task(f"moving contours of {name!r} to edges", steps, unit="view") as bar:

        def moved(row: int) -> Mask:
            covered = (coverage(splats, cameras[row], picked) > COVERED).cpu()
            bar.advance()
            return move_to_edges(images.colors(row), covered)

        for left in reversed(range(CONTOUR_ROUNDS)):
            before, masks = masks, [moved(row) for row in rows]
            overlap = [mask_iou(*each) for each in zip(before, masks, strict=False)]
            if left == 0 or sum(overlap) > CONTOURS_SETTLED * len(rows):
                bar.advance(left * len(rows))
                break
            votes = lift_masks(splats, cameras, dict(enumerate(masks)))
            is_shown = votes.votes.sum(dim=1) > MIN_SHOWN
            picked = torch.where(is_shown, votes.share > MIN_SHARE, picked)
    return masks


@torch.no_grad()
def propagate_marks(
    splats: Splats, cameras: Cameras, marks: Sequence[tuple[int, ViewMask, ViewMask]]
) -> list[tuple[ViewMask, ViewMask]]:
    """The pixels of every view that belong to an object, and that do not, from those of some.

    What lies mostly within a mark there is marked in all views. A line names the views with a mark
    that no Gaussian lies mostly within.
    """
    is_marked = splats.means.new_zeros(len(splats), 2)
    for row, *given in marks:
        masks = torch.stack([*given, torch.ones_like(given[0])], dim=-1)
        pixels = pixels_in(splats, cameras[row], [masks])
        shows = pixels[:, 2:] > MIN_SHOWN
        meant = (pixels[:, :2] > 0.5 * pixels[:, 2:]) & shows
        is_marked[meant] = 1
        for drawn, of in zip(given, meant.unbind(dim=1), strict=True):
            if drawn.any() and not of.any():
                say(
                    f"No Gaussian lies mostly within a mark in {cameras.names[row]}, so the mark "
                    "changes that photo alone. Mark more around it."
                )
    views = list[tuple[ViewMask, ViewMask]]()
    for camera in cameras:
        kept, dropped = (composite(splats, camera, is_marked) > COVERED).cpu().unbind(dim=2)
        views.append((kept, dropped))
    for row, kept, dropped in marks:
        views[row] = (views[row][0] & ~dropped) | kept, (views[row][1] & ~kept) | dropped
    return views


def nearest_views(cameras: Cameras, seeds: Sequence[int]) -> list[int]:
    """The other views, those that look from the side of a seed first."""
    positions, forward = cameras.positions, cameras.viewmats[:, 2, :3]
    scale = (positions - positions.mean(dim=0)).norm(dim=1).mean().clamp(min=1e-9)
    apart = torch.cdist(positions, positions[seeds]) / scale
    turned = 1 - forward @ forward[list(seeds)].T
    order = (apart + turned).amin(dim=1).argsort().tolist()
    return [row for row in order if row not in seeds]


def _refine_views(
    splats: Splats,
    cameras: Cameras,
    images: Images,
    votes: MaskVotes,
    rows: Sequence[int],
    channels: Channels,
    advance: Callable[[int], None],
) -> dict[int, ViewMask]:
    """The masks in some views; GrabCut, which takes longest, runs in several at a time."""
    found: dict[int, ViewMask] = {}
    threads = torch.get_num_threads()
    with ThreadPoolExecutor(threads) as pool:
        for start in range(0, len(rows), threads):
            group = rows[start : start + threads]
            rendered = (render_votes(splats, cameras, votes, row) for row in group)
            probabilities, novelties = zip(*rendered, strict=True)
            group_images = [images.with_depth(row) for row in group]
            masks = pool.map(refine_mask, group_images, probabilities, novelties, repeat(channels))
            found |= zip(group, masks, strict=True)
            advance(len(group))
    return found

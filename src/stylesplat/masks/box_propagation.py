"""From boxes around an object in a few photos to its masks in all photos, by way of a splat."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import repeat

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.masks.box_picks import pick_in_boxes
from stylesplat.masks.contours import move_to_edges
from stylesplat.masks.grabcut import (
    Box,
    Channels,
    ColorLevels,
    GrabCutImage,
    Stroke,
    color_levels,
    cut_box,
    grabcut_image,
    refine_mask,
)
from stylesplat.metrics.iou import mask_iou
from stylesplat.progress import task
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED, PRIOR, contributed, coverage, render_shares
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import Mask
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import IDENTITY_SIZE, Splats

GROWTH = 2  # factor between the numbers of masked views before and after a round
SETTLING_ROUNDS = 2  # over all views at most, after each has a mask
SETTLED = 0.98  # mean IoU with the round before, at which they stop
CONTOUR_ROUNDS = 5  # of moving contours to edges, at most
CONTOURS_SETTLED = 0.998  # mean IoU with the round before, at which they stop
CLOSER = 2.0  # times more pixels than in any known view, from which a Gaussian is new
MIN_SHOWN = 0.5  # pixels that a Gaussian makes up, from which marks and masks can mean it
# Share of a Gaussian's pixels in masks, from which it belongs to an object that is rendered again:
# with .5 the lowest tenth of the fox has an IoU of .89, with .4 .91; renders then grow too wide.
MIN_SHARE = 0.4
MIN_ALPHA = 0.05  # below which the depth of a pixel means nothing


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
        image, alphas = render(splats, camera, features=inverse[:, None], sh_degree=0)
        inverse_depth = (image[..., 3] / alphas[..., 0].clamp(min=MIN_ALPHA)).cpu()
        return grabcut_image(colors(row), inverse_depth)

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

    def merged(self, other: "MaskVotes") -> "MaskVotes":
        closest = torch.maximum(self.closest, other.closest)
        return MaskVotes(self.rows | other.rows, self.votes + other.votes, closest)


def lift_masks(splats: Splats, cameras: Cameras, masks: Mapping[int, Mask]) -> MaskVotes:
    """The votes of masks, given by the row of their view."""
    votes = splats.means.new_zeros(len(splats), 2)
    closest = splats.means.new_zeros(len(splats))
    for row, mask in masks.items():
        pixels = _pixels_in(splats, cameras[row], mask, ~mask)
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
        everywhere = torch.ones(height, width, dtype=torch.bool)
        new += _pixels_in(splats, cameras[row], everywhere)[:, 0] > CLOSER * votes.closest
    features = torch.stack([votes.share, new], dim=1)
    image, _ = render(splats, cameras[row], features=features, sh_degree=0)
    probability, novelty = image[..., 3:].clamp(0, 1).cpu().unbind(dim=-1)
    return probability, novelty


@torch.no_grad()
def propagate_boxes(
    splats: Splats,
    cameras: Cameras,
    images: Images,
    boxes: Sequence[tuple[int, Box]],
    strokes: Sequence[tuple[int, Stroke]] = (),
    *,
    name: str = "object",
) -> list[Mask]:
    """The masks of an object in every view, from boxes around it in one or a few.

    GrabCut segments there. What it finds is completed and bounded on the surface of the splat,
    without the plane that the object stands on. If that fills the boxes as well, its renders are
    the masks, with contours moved to edges. Otherwise the masks are lifted onto the Gaussians,
    rendered into the nearest other views and their contours moved to edges; then the next views,
    until all have one; then all again until they settle.

    Args:
        splats: A scene of the views; its labels do not matter.
        cameras: One per view.
        images: Of `view_images`.
        boxes: Rows of views, and boxes in their pixels.
        strokes: Rows of views with a box, and strokes in them.
        name: The object's, for the progress bar.

    Returns:
        A mask per view; empty where the object does not show.
    """
    cuts = {}
    for row, box in boxes:
        drawn = [stroke for at, stroke in strokes if at == row]
        cuts[row] = cut_box(images.with_depth(row), box, cameras.names[row], drawn)
    picked = pick_in_boxes(splats, cameras, boxes, {row: cut for row, (_, cut) in cuts.items()})
    if picked is not None:
        return _masks_at_edges(splats, cameras, images, picked, name)
    channels = cuts[boxes[0][0]][0]
    known = {row: mask for row, (_, mask) in cuts.items()}
    others, votes = nearest_views(cameras, [*known]), lift_masks(splats, cameras, known)
    rounds = 1 + SETTLING_ROUNDS
    with task(f"spreading the mask of {name!r}", rounds * len(others), unit="view") as bar:

        def refine_views(rows: Sequence[int]) -> dict[int, Mask]:
            return _refine_views(splats, cameras, images, votes, rows, channels, bar.advance)

        start = 0
        while start < len(others):
            found = refine_views(others[start : start + max(1, (GROWTH - 1) * len(known))])
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
) -> list[Mask]:
    """The masks of picked Gaussians, whose contours lie at edges of photos.

    Masks are lifted, so that views agree on them, rendered, and their contours moved again, until
    they stay. In several rounds thin legs grow to their ends.
    """
    rows, masks = range(len(cameras)), list[Mask]()
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
def spread_marks(
    splats: Splats, cameras: Cameras, marks: Sequence[tuple[int, Mask, Mask]]
) -> list[tuple[Mask, Mask]]:
    """The pixels of every view that belong to an object, and that do not, from those of some.

    What lies mostly within a mark there is marked in all views.
    """
    is_marked = splats.means.new_zeros(len(splats), 2)
    for row, *given in marks:
        pixels = _pixels_in(splats, cameras[row], *given, torch.ones_like(given[0]))
        shows = pixels[:, 2:] > MIN_SHOWN
        is_marked[(pixels[:, :2] > 0.5 * pixels[:, 2:]) & shows] = 1
    views = list[tuple[Mask, Mask]]()
    for camera in cameras:
        kept, dropped = (render_shares(splats, camera, is_marked) > COVERED).cpu().unbind(dim=2)
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
) -> dict[int, Mask]:
    """The masks in some views; GrabCut, which takes longest, runs in several at a time."""
    found: dict[int, Mask] = {}
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


def _pixels_in(splats: Splats, camera: Cameras, *masks: Mask) -> Float[Tensor, "N M"]:
    """How many pixels of each mask each Gaussian makes up."""
    wanted = splats.means.new_zeros(*masks[0].shape, IDENTITY_SIZE)
    for column, mask in enumerate(masks):
        wanted[..., column] = mask
    return contributed(splats, camera, wanted)[:, : len(masks)]

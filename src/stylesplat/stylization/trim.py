"""Discs that show what the object showed and no more, once they are turned along their strokes.

Discs that show beside the object shrink or go (`trim_surfels`). A pixel may show a filigree and
what is behind it, or strings and the wood below: discs at its depth close the one and hide the
other. Such discs go, and the object's own Gaussians come back (`reveal`). Those that are large get
discs in their place (`split_large`). Discs beside small gaps become wider (`close_gaps`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter
from torch import Tensor

from stylesplat.imaging.morphology import disc
from stylesplat.imaging.similarity import smooth
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.surface import front_depth, poisson_disk_sample
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.visibility import pixel_bounds, touching
from stylesplat.rendering.weights import (
    COVERED,
    TINY_COVERAGE,
    Contributions,
    backproject,
    contributions,
    coverage,
    geometry_only,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import UNSEEN
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import depths_of
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.selection.shapes import robust_diameter
from stylesplat.stylization.canvas import (
    CANVAS_OPACITY,
    SHOWN_LEAST,
    Canvas,
    UnpaintedView,
    discs_at,
    fade_covered,
    pixels_shown,
)
from stylesplat.stylization.guides import Guides, align_to_strokes
from stylesplat.stylization.views import ObjectBox, box_cameras, reached_pixels

SPILL_VIEWS = 24  # that are checked: discs lie on the very outline of the object
SPILL_COARSER = 2.0  # ratio of the photos' size to that of the check: finds the same as full size
LEAST_SIZE = 480  # pixels of the check's longer side, so that small photos are checked in full
SPILL_MARGIN = 16  # pixels around what the object may reach in them
SPILL_FAINT = 0.1  # coverage: less is haze, unless it is the soft edge
SPILL_EDGE = disc(5)  # two pixels around what is covered are its edge
SMALLER = 0.6  # factor on the size of a disc that shows beside the object
SHINES = 0.1  # pixels of a disc that shine through what is protected, if that lies before it
CANVAS_LOST = 0.2  # coverage: where the object would lose more, the canvas has a hole
CANVAS_RIM = 3  # pixels along the object's outline that are no holes
# Part of a Gaussian's contribution that has to lie in holes, for it to come back, or beside gaps,
# for a disc to become wider. It leaves a quarter to a half of the holes of a fox, a biker and a
# brooch; .005 leaves a tenth of the fox's, but nearly twice as many Gaussians come back, which
# carry no strokes
IN_HOLES = 0.02


class ForbiddenPixels(NamedTuple):
    """Where no disc may show."""

    camera: Cameras
    pixels: Bool[Tensor, "H W"]
    most: float = 0.0
    """Pixels of each disc that may, all the same."""
    rows: Int[Tensor, " L"] | None = None
    """The only Gaussians that reach these pixels, if that is known."""


@torch.no_grad()
def trim_surfels(
    canvas: Canvas,
    cameras: Cameras,
    *,
    painted: Splats | None = None,
    protected: Bool[Tensor, " B"] | None = None,
    guides: Guides | None = None,
) -> tuple[Canvas, Bool[Tensor, " M"]]:
    """Turn the discs of a canvas along the strokes, and let none show beside the object.

    Discs that show beside it in a camera become smaller; those that still do are removed. Without
    the canvas painted in the colours of the strokes, discs stay round. Nor may discs show on what
    is protected of the Gaussians before. Returns also which Gaussians of the canvas are left.
    """
    splats, round_discs = canvas.before, canvas.splats
    if painted is not None:
        turned = align_to_strokes(painted, canvas.is_disc, canvas.spacing, guides)
        canvas = canvas.changed(quats=turned.quats, scales=turned.scales)
    coarser = min(SPILL_COARSER, max(1.0, float(cameras.sizes.max()) / LEAST_SIZE))
    checked = cameras[[*evenly_spaced(range(len(cameras)), SPILL_VIEWS)]].downscale(coarser)
    checked = _crop_to_gaussians(splats[canvas.own], checked)
    outside = _find_outside(splats, canvas.own, protected, checked)
    rows, outside = _overflow(canvas, outside)
    scales = canvas.splats.scales.clone()
    scales[rows] = round_discs.scales[rows] + math.log(SMALLER)
    canvas = canvas.changed(scales=scales)
    kept = torch.ones_like(canvas.is_disc)
    while outside:  # a removed disc may uncover others
        rows, outside = _overflow(canvas, outside)
        kept[rows] = False
        canvas = canvas.changed(opacities=canvas.splats.opacities.index_fill(0, rows, UNSEEN))
    return fade_covered(canvas.select(kept)), kept  # what removed discs hid comes back


def _crop_to_gaussians(splats: Splats, cameras: Cameras) -> list[Cameras]:
    """The part of each camera's image that Gaussians may reach; cameras that see none go."""
    crops = []
    for camera in cameras:
        low, high = pixel_bounds(splats, camera)
        most = camera.sizes[0].to(high)
        low, high = (low - SPILL_MARGIN).clamp(min=0), torch.minimum(high + SPILL_MARGIN, most)
        reached = (low < high).all(dim=1)
        if reached.any():
            low, high = low[reached].amin(dim=0), high[reached].amax(dim=0)
            crops.append(camera.crop(low.tolist(), (high - low).tolist()))
    return crops


def _find_outside(
    splats: Splats, mask: Tensor, protected: Tensor | None, cameras: Sequence[Cameras]
) -> list[ForbiddenPixels]:
    """Where there is nothing of an object, haze away from its edge, or what is protected."""
    bare = geometry_only(splats)
    own = bare[mask]

    def look(camera: Cameras) -> list[ForbiddenPixels]:
        covered = coverage(bare, camera, mask)
        alone = coverage(own, camera)  # whatever hides it
        solid = binary_dilation((alone > COVERED).cpu().numpy(), SPILL_EDGE)
        edge = torch.from_numpy(solid).to(covered.device)
        found = [ForbiddenPixels(camera, (covered == 0) | ((covered < SPILL_FAINT) & ~edge))]
        if protected is not None:
            found.append(
                ForbiddenPixels(camera, coverage(bare, camera, protected) > COVERED, SHINES)
            )
        return found

    return [*chain(*per_view(look, cameras, "looking beside the object", splats.device))]


def _overflow(
    canvas: Canvas, outside: Sequence[ForbiddenPixels]
) -> tuple[Int[Tensor, " M"], list[ForbiddenPixels]]:
    """The discs that show outside the object, and where others may next."""
    bare, is_disc = geometry_only(canvas.splats), canvas.is_disc

    def look(view: ForbiddenPixels) -> tuple[Tensor, ForbiddenPixels]:
        camera, rows, pixels = view.camera, view.rows, view.pixels
        part = bare if rows is None else bare[rows]
        rows = torch.arange(len(bare), device=bare.device) if rows is None else rows
        low, high = pixel_bounds(part, camera)
        suspects = touching(low, high, pixels) & is_disc[rows]
        pixels = pixels & reached_pixels(part[suspects], camera)
        there = touching(low, high, pixels).nonzero()[:, 0]
        seen = contributions(part[there], camera, is_disc[rows[there]])
        found = rows[there[seen.pixels_in(pixels) > view.most]]
        return found, view._replace(
            pixels=pixels & reached_pixels(bare[found], camera), rows=rows[there]
        )

    looks = [*per_view(look, outside, "checking the outline", bare.device)]
    found = torch.cat([is_disc.nonzero()[:0, 0], *(rows for rows, _ in looks)]).unique()
    return found, [view for rows, view in looks if len(rows)]


@torch.no_grad()
def restore_in_holes(canvas: Canvas) -> Canvas:
    """Give the Gaussians that show in holes between the discs their opacity back."""
    faded, mask = geometry_only(canvas.splats), canvas.mask

    def look(view: UnpaintedView) -> Tensor:
        linear = view.linear
        lost = linear.coverage - coverage(faded, view.camera, mask) > CANVAS_LOST
        lost &= _inner(linear.coverage > COVERED)
        masks = torch.stack([lost, torch.ones_like(lost)], dim=-1)
        in_holes, everywhere = linear.pixels_in(masks).unbind(dim=1)
        return (in_holes > IN_HOLES * everywhere).nonzero()[:, 0]

    found = per_view(look, canvas.views, "looking for holes of the canvas", faded.device)
    rows = torch.cat([*found])
    opacities = canvas.splats.opacities.clone()
    opacities[rows] = canvas.before.opacities[rows]
    return canvas.changed(opacities=opacities)


def _inner(covered: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """The pixels of an object away from its outline."""
    inner = minimum_filter(covered.cpu().numpy(), 2 * CANVAS_RIM + 1)
    return torch.from_numpy(inner).to(covered.device)


REVEAL_VIEWS, REVEAL_ROUNDS = 18, 2  # after one round a second layer of discs shows
FEW_GONE = 0.02  # share of the discs: if fewer go, there is no layer below to show
GAINED = 0.15  # coverage that discs may add to what was open
# Of the object's extent: what is as near behind discs is what they lie on, and no hole
JUST_BEHIND = 0.04
REVEAL_SOLID = 0.9  # coverage from which colours are the object's own
# Difference of colours from which they are unlike; deviations of the blur that is subtracted from
# it, in lengths of the object, and of the one that averages it, in pixels
UNLIKE, UNLIKE_MEAN, UNLIKE_BLUR = 0.1, 0.02, 1.0
# Shares of a disc's pixels there, from which it goes. With .05 in holes two fifths more of a
# brooch's stay closed
DISC_OPEN, DISC_UNLIKE = 0.03, 0.4
OWN_LOST, OWN_UNLIKE = 0.1, 0.3  # shares of a Gaussian's, from which it comes back
# Share of a disc's pixels that only it covers, from which it comes back, if it closes fewer
DISC_LOST = 0.04
REVEAL_NEIGHBOURS = 12  # discs that each one follows
FOLLOWS_GONE, FOLLOWS_STAYING = 0.5, 0.15  # shares of them that are gone


@torch.no_grad()
def reveal(
    canvas: Canvas, boxes: Sequence[ObjectBox], length: float, *, has_parts: bool
) -> tuple[Canvas, Bool[Tensor, " M"]]:
    """Take discs away where they close holes, or hide what they do not show.

    The Gaussians that they hid come back, and so do those in holes of what was solid. An object
    without parts has a pattern, which is to be hidden. The views show the object so many pixels
    long. Returns also which Gaussians are left.
    """
    cameras = box_cameras(boxes, length, REVEAL_VIEWS)
    first, weights, closes = canvas, None, torch.zeros_like(canvas.splats.opacities)
    is_gone, is_back = torch.zeros_like(canvas.is_disc), torch.zeros_like(canvas.own)
    for left in reversed(range(REVEAL_ROUNDS)):
        own, discs = _weights_in_faults(canvas, cameras, length, has_parts=has_parts)
        is_open, is_unlike, everywhere = discs.unbind(dim=1)
        weights = everywhere if weights is None else weights
        closes = closes.maximum(is_open)
        gone = (is_open > DISC_OPEN * everywhere) | (is_unlike > DISC_UNLIKE * everywhere)
        is_gone |= gone & canvas.is_disc
        is_last = left == 0 or is_gone.sum() <= FEW_GONE * canvas.is_disc.sum()
        if is_last:
            is_gone = _follow_neighbours(canvas, is_gone)
        opacities = first.splats.opacities.masked_fill(is_gone, UNSEEN)
        canvas = fade_covered(canvas.changed(opacities=opacities))
        lost, unlike, everywhere = own.unbind(dim=1)
        back = (lost > OWN_LOST * everywhere) | (unlike + lost > OWN_UNLIKE * everywhere)
        is_back |= back & canvas.own
        canvas = _with_own(canvas, is_back)
        if is_last:
            break
    assert weights is not None
    fills = _lost_pixels(first, canvas, cameras)
    needed = is_gone & (fills > DISC_LOST * weights) & (fills > closes)
    is_gone &= ~needed
    opacities = canvas.splats.opacities.where(~needed, first.splats.opacities)
    canvas = canvas.changed(opacities=opacities).select(~is_gone)
    return restore_in_holes(canvas), ~is_gone


def _with_own(canvas: Canvas, back: Bool[Tensor, " B"]) -> Canvas:
    """The canvas with the opacity that some of the object's Gaussians had before."""
    count = len(canvas.own)
    opacities = canvas.splats.opacities.clone()
    opacities[:count] = torch.where(back, canvas.before.opacities, opacities[:count])
    return canvas.changed(opacities=opacities)


def _weights_in_faults(
    canvas: Canvas, cameras: Sequence[Cameras], length: float, *, has_parts: bool
) -> tuple[Float[Tensor, "B 3"], Float[Tensor, "M 3"]]:
    """Pixels by Gaussian: before (lost, unlike, all), and of the canvas (open, unlike, all)."""
    before, after = canvas.before, canvas.splats
    near = JUST_BEHIND * robust_diameter(before.means[canvas.own])

    def look(camera: Cameras) -> tuple[Tensor, Tensor]:
        was, now = (
            contributions(splats, camera, mask)
            for splats, mask in ((before, canvas.own), (after, canvas.mask))
        )
        gained = now.coverage - was.coverage
        is_open = (was.coverage < COVERED) & (gained > GAINED)
        if not canvas.own.all() and is_open.any():
            is_open &= _opens_far(canvas, camera, now, near)
        is_lost = gained < -CANVAS_LOST
        is_unlike = torch.zeros_like(is_open)
        if has_parts:
            change = _picture(before, was) - _picture(after, now)
            everywhere = torch.ones_like(is_open)
            change = change.permute(2, 0, 1)
            change = change - smooth(change, everywhere, UNLIKE_MEAN * length)
            strength = smooth(change.abs().mean(dim=0), everywhere, UNLIKE_BLUR)
            is_unlike = (strength > UNLIKE) & (was.coverage > REVEAL_SOLID)
        both = [is_unlike, torch.ones_like(is_open)]
        own, discs = (torch.stack([each, *both], dim=-1) for each in (is_lost, is_open))
        return was.pixels_in(own), now.pixels_in(discs)

    found = per_view(look, cameras, "comparing the canvas", before.device)
    own, discs = zip(*found, strict=True)
    return torch.stack(own).sum(dim=0), torch.stack(discs).sum(dim=0)


def _picture(splats: Splats, linear: Contributions) -> Float[Tensor, "H W 3"]:
    """A view of an object in colours that are the same from everywhere."""
    return linear.render(rgb_from_sh0(splats.sh0[linear.gaussians, 0]).relu())


def _opens_far(
    canvas: Canvas, camera: Cameras, linear: Contributions, near: float
) -> Bool[Tensor, "H W"]:
    """Where nothing of the scene before is just behind the discs."""
    depths, alphas = front_depth(canvas.before, camera)
    rows = linear.gaussians
    is_disc = canvas.is_disc[rows].to(depths)
    values = torch.stack([is_disc, is_disc * depths_of(canvas.splats.means[rows], camera)], dim=1)
    covered, own_depths = linear.composite(values).unbind(dim=2)
    own_depths = own_depths / covered.clamp(min=TINY_COVERAGE)
    return (alphas < COVERED) | (depths > own_depths + near)


def _follow_neighbours(canvas: Canvas, is_gone: Bool[Tensor, " M"]) -> Bool[Tensor, " M"]:
    """Which discs go if each one does as most around it."""
    rows = canvas.is_disc.nonzero()[:, 0]
    if len(rows) <= REVEAL_NEIGHBOURS:
        return is_gone
    points, gone = canvas.splats.means[rows], is_gone[rows]
    _, near = nearest_points(points, points, REVEAL_NEIGHBOURS + 1)
    share = gone[near[:, 1:]].float().mean(dim=1)
    followed = is_gone.clone()
    followed[rows] = (gone & (share >= FOLLOWS_STAYING)) | (share > FOLLOWS_GONE)
    return followed


def _lost_pixels(first: Canvas, canvas: Canvas, cameras: Sequence[Cameras]) -> Float[Tensor, " M"]:
    """Pixels of each Gaussian of the first canvas where a solid part of the object is missing."""
    bare, lost = geometry_only(canvas.splats), torch.zeros_like(first.splats.opacities)

    def look(camera: Cameras) -> Tensor | None:
        was = coverage(first.before, camera, first.own)
        is_lost = was - coverage(bare, camera, canvas.mask) > CANVAS_LOST
        if not is_lost.any():
            return None
        return backproject(geometry_only(first.splats), camera, is_lost[..., None].to(was))[:, 0]

    for pixels in per_view(look, cameras, "looking for what is missing", bare.device):
        if pixels is not None:
            lost += pixels
    return lost


# An own Gaussian that shows through the canvas and is wider than so many spacings has a single
# colour where strokes would be. Discs take its place, as far as so many of its deviations
LARGE, REACH = 2.0, 2.0
LARGE_SHOWN = 10.0  # pixels that it shows in some view; in the canvas's own there are 10 to one
SPLIT_FAINT = 0.1  # opacity of the Gaussian at a place from which no disc is laid there
SPLIT_SIDE = 64  # discs along a Gaussian at most: larger ones are too few to matter
SPLIT_MOST = 1_000_000  # places of discs to choose from at most: they take 1 GiB
OVERLAP = 2.45  # discs of `DISC_WIDE` that cover a place, when they are as dense as they get


@torch.no_grad()
def split_large(canvas: Canvas, length: float, *, seed: int) -> tuple[Canvas, Int[Tensor, " N"]]:
    """The canvas with discs in place of the large and flat Gaussians of the object that it shows.

    Views show the object so many pixels long. Returns also of which Gaussian of the canvas each one
    has the colour.
    """
    splats, count = canvas.splats, len(canvas.own)
    everyone = torch.arange(len(splats), device=splats.device)
    sizes, order = splats.scales[:count].exp().sort(dim=1, descending=True)
    opacities = torch.sigmoid(splats.opacities[:count])
    is_flat = sizes[:, 2] < sizes[:, 1] / 2
    is_large = canvas.own & is_flat & (sizes[:, 1] > LARGE * canvas.spacing)
    is_large &= opacities > SPLIT_FAINT
    if not canvas.is_disc.any() or not is_large.any():
        return canvas, everyone
    pixels = pixels_shown(canvas, length)[:count]
    rows = (is_large & (pixels > LARGE_SHOWN)).nonzero()[:, 0]
    sides = (2 * REACH * sizes[rows, :2] / canvas.spacing).ceil().clamp(1, SPLIT_SIDE).long()
    grids, most_first = sides.prod(dim=1), pixels[rows].argsort(descending=True)
    fits = torch.zeros_like(rows, dtype=torch.bool)
    fits[most_first] = grids[most_first].cumsum(dim=0) <= SPLIT_MOST
    rows, sides, grids = rows[fits], sides[fits], grids[fits]
    which = torch.arange(len(rows), device=rows.device).repeat_interleave(grids)
    number = torch.arange(len(which), device=rows.device) - (grids.cumsum(0) - grids)[which]
    along = torch.stack([number % sides[which, 0], number // sides[which, 0]], dim=1)
    places = REACH * (2 * (along + 0.5) / sides[which] - 1)  # in deviations
    shown = opacities[rows][which] * (-places.square().sum(dim=1) / 2).exp()
    kept = (shown > SPLIT_FAINT).nonzero()[:, 0]
    which, places, shown = which[kept], places[kept], shown[kept]
    turns = rotation_matrices(splats.quats[rows])
    axes = turns.gather(2, order[rows][:, None].expand_as(turns))[which]
    offsets = torch.einsum("dij,dj->di", axes[..., :2], places * sizes[rows[which], :2])
    means = splats.means[rows[which]] + offsets
    chosen = poisson_disk_sample(means, canvas.spacing, seed=seed)
    parents = rows[which[chosen]]
    opaque = (1 - (1 - shown[chosen]).clamp(min=1e-6) ** (1 / OVERLAP)).clamp(max=CANVAS_OPACITY)
    normals = axes[chosen, :, 2]
    discs = discs_at(splats[parents], means[chosen], normals, canvas.spacing, opaque)
    below = replace(splats, opacities=splats.opacities.index_fill(0, rows, UNSEEN))
    split = replace(
        canvas,
        splats=Splats.cat([below, discs]),
        parents=torch.cat([canvas.parents, parents]),
    )
    kept = ~split.is_disc | (pixels_shown(split, length) >= SHOWN_LEAST)
    return split.select(kept), torch.cat([everyone, parents])[kept]


BESIDE_GAPS = 3  # pixels of a square around each one that shows through: discs are as large
# Factor on the size of a disc beside gaps, which undoes half of how narrow a turned one is. It
# leaves an eighth to three fifths of the gaps of a bottle, a fox and a brooch
GAP_WIDER = 1.3


@torch.no_grad()
def close_gaps(canvas: Canvas, boxes: Sequence[ObjectBox], length: float) -> Canvas:
    """The canvas with wider discs where a solid object shows what is behind it between them.

    Turned discs are narrow, and leave gaps where layers of them meet. Views show the object so many
    pixels long.
    """
    bare, before = geometry_only(canvas.splats), geometry_only(canvas.before)

    def look(camera: Cameras) -> Tensor:
        covered = coverage(before, camera, canvas.own)
        now = contributions(bare, camera, canvas.mask)
        gaps = (covered - now.coverage > CANVAS_LOST) & _inner(covered > REVEAL_SOLID)
        beside = torch.from_numpy(maximum_filter(gaps.cpu().numpy(), BESIDE_GAPS)).to(gaps.device)
        return now.pixels_in(torch.stack([beside, torch.ones_like(beside)], dim=-1))

    cameras = box_cameras(boxes, length, REVEAL_VIEWS)
    found = per_view(look, cameras, "closing gaps between discs", bare.device)
    beside, everywhere = torch.stack([*found]).sum(dim=0).unbind(dim=1)
    wider = canvas.is_disc & (beside > IN_HOLES * everywhere)
    scales = canvas.splats.scales + math.log(GAP_WIDER) * wider[:, None]
    return canvas.changed(scales=scales)

"""The canvas shows what the object shows: open-work stays open, thin parts and letters are there.

A pixel may show a filigree and what is behind it, or strings and the wood below: discs at its depth
close the one and hide the other. Such discs go, and the object's own Gaussians come back.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.imaging.similarity import smooth
from stylesplat.rendering.surface import front_depth
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
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.selection.shapes import robust_diameter
from stylesplat.stylization.canvas import CANVAS_LOST, Canvas, fade_covered
from stylesplat.stylization.views import ObjectBox, box_cameras, per_view

REVEAL_VIEWS, REVEAL_ROUNDS = 18, 2  # after one round a second layer of discs shows
FEW_GONE = 0.02  # share of the discs: if fewer go, there is no layer below to show
GAINED = 0.15  # coverage that discs may add to what was open
# Of the object's extent: what is as near behind discs is what they lie on, and no hole
JUST_BEHIND = 0.04
REVEAL_SOLID = 0.9  # coverage from which colours are the object's own
# Difference of colours from which they are unlike; deviations of the blur that is subtracted from
# it, in lengths of the object, and of the one that averages it, in pixels
UNLIKE, UNLIKE_MEAN, UNLIKE_BLUR = 0.1, 0.02, 1.0
DISC_OPEN, DISC_UNLIKE = 0.05, 0.4  # shares of a disc's pixels there, from which it goes
OWN_LOST, OWN_UNLIKE = 0.1, 0.3  # shares of a Gaussian's, from which it comes back
DISC_LOST = 0.04  # share of a disc's pixels that only it covers, from which it comes back
REVEAL_NEIGHBOURS = 12  # discs that each one follows
FOLLOWS_GONE, FOLLOWS_STAYING = 0.5, 0.15  # shares of them that are gone


@torch.no_grad()
def reveal(
    canvas: Canvas, boxes: Sequence[ObjectBox], length: float, *, has_parts: bool
) -> tuple[Canvas, Bool[Tensor, " M"]]:
    """Take discs away where they close holes, or hide what they do not show.

    The Gaussians that they hid come back. An object without parts has a pattern, which is to be
    hidden. The views show the object so many pixels long. Returns also which Gaussians are left.
    """
    cameras = box_cameras(boxes, length, REVEAL_VIEWS)
    first, weights = canvas, None
    is_gone, is_back = torch.zeros_like(canvas.is_disc), torch.zeros_like(canvas.own)
    for left in reversed(range(REVEAL_ROUNDS)):
        own, discs = _weights_in_faults(canvas, cameras, length, has_parts=has_parts)
        is_open, is_unlike, _, everywhere = discs.unbind(dim=1)
        weights = everywhere if weights is None else weights
        gone = (is_open > DISC_OPEN * everywhere) | (is_unlike > DISC_UNLIKE * everywhere)
        is_gone |= gone & canvas.is_disc
        is_last = left == 0 or is_gone.sum() <= FEW_GONE * canvas.is_disc.sum()
        if is_last:
            is_gone = _follow_neighbours(canvas, is_gone)
        opacities = first.splats.opacities.masked_fill(is_gone, UNSEEN)
        canvas = fade_covered(canvas.changed(opacities=opacities))
        _, unlike, lost, everywhere = own.unbind(dim=1)
        back = (lost > OWN_LOST * everywhere) | (unlike + lost > OWN_UNLIKE * everywhere)
        is_back |= back & canvas.own
        canvas = _with_own(canvas, is_back)
        if is_last:
            break
    assert weights is not None
    needed = is_gone & (_lost_pixels(first, canvas, cameras) > DISC_LOST * weights)
    is_gone &= ~needed
    opacities = canvas.splats.opacities.where(~needed, first.splats.opacities)
    return canvas.changed(opacities=opacities).select(~is_gone), ~is_gone


def _with_own(canvas: Canvas, back: Bool[Tensor, " B"]) -> Canvas:
    """The canvas with the opacity that some of the object's Gaussians had before."""
    count = len(canvas.own)
    opacities = canvas.splats.opacities.clone()
    opacities[:count] = torch.where(back, canvas.before.opacities, opacities[:count])
    return canvas.changed(opacities=opacities)


def _weights_in_faults(
    canvas: Canvas, cameras: Sequence[Cameras], length: float, *, has_parts: bool
) -> tuple[Float[Tensor, "B 4"], Float[Tensor, "M 4"]]:
    """Pixels of each Gaussian before, and of the canvas, that are open, unlike, lost, and all."""
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
        faults = torch.stack([is_open, is_unlike, is_lost, torch.ones_like(is_open)], dim=-1)
        return was.pixels_in(faults), now.pixels_in(faults)

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
    points = canvas.splats.means[rows].double().cpu().numpy()
    _, near = KDTree(points).query(points, k=REVEAL_NEIGHBOURS + 1, workers=-1)
    gone = is_gone[rows]
    share = gone[torch.from_numpy(np.asarray(near)[:, 1:]).to(rows)].float().mean(dim=1)
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

"""Confining a canvas to its object: discs show only where something of the object showed."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.rendering.linear import contributions
from stylesplat.rendering.shares import COVERED, coverage, without_looks
from stylesplat.rendering.visibility import pixel_bounds, touching
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.canvas import Canvas, fade_hidden, fill_holes
from stylesplat.stylization.strokes import align_to_strokes
from stylesplat.stylization.surface import full_coverage
from stylesplat.stylization.views import Box, per_view

VIEWS = 24  # that are checked: discs lie on the very outline of the object
COARSER = 2.0  # ratio of the photos' size to that of the check: finds the same as full size
LEAST_SIZE = 480  # pixels of the check's longer side, so that small photos are checked in full
MARGIN = 16  # pixels around what the object may reach in them
FAINT = 0.1  # coverage: less is haze, unless it is the soft edge
EDGE = 2  # pixels around what is covered that are its edge
SMALLER = 0.6  # factor on the size of a disc that shows beside the object
SHINES = 0.1  # pixels of a disc that shine through what is protected, if that lies before it

# One camera, the pixels [H, W] in which no disc may show, and the pixels of each that may
Outside = tuple[Cameras, Tensor, float]
NO_ROWS = torch.zeros(0, dtype=torch.long)


@torch.no_grad()
def confine_canvas(
    canvas: Canvas,
    boxes: Sequence[Box],
    cameras: Cameras,
    *,
    painted: Splats | None = None,
    protected: Bool[Tensor, " B"] | None = None,
) -> tuple[Canvas, Bool[Tensor, " M"]]:
    """Turn the discs of a canvas along the strokes, and let none show beside the object.

    Discs that show beside it become smaller; those that still do are removed.

    Args:
        canvas: What was laid, on the CPU.
        boxes: Where the object is seen.
        cameras: Views in which nothing may show beside it.
        painted: The canvas in the colours of the strokes; None leaves the discs round.
        protected: Gaussians of the scene before that no disc may show on.

    Returns:
        The canvas, and which of its Gaussians are left.
    """
    splats, round_discs = canvas.before, canvas.splats
    if painted is not None:
        turned = align_to_strokes(painted, canvas.is_disc, canvas.spacing)
        canvas = canvas.changed(quats=turned.quats, scales=turned.scales)
    coarser = min(COARSER, max(1.0, float(cameras.sizes.max()) / LEAST_SIZE))
    checked = cameras[[*evenly(range(len(cameras)), VIEWS)]].downscale(coarser)
    checked = _crop_to_gaussians(splats[canvas.own], checked)
    outside = _find_outside(splats, canvas.own, checked)
    if protected is not None:
        outside += _find_covered(splats, protected, checked)
    rows, outside = _overflow(canvas, outside)
    scales = canvas.splats.scales.clone()
    scales[rows] = round_discs.scales[rows] + math.log(SMALLER)
    canvas = canvas.changed(scales=scales)
    kept = torch.ones_like(canvas.is_disc)
    while outside:  # a removed disc may uncover others
        rows, outside = _overflow(canvas.select(kept), outside)
        kept[kept.nonzero()[rows, 0]] = False
    return fill_holes(fade_hidden(canvas.select(kept), boxes), boxes), kept


def _crop_to_gaussians(splats: Splats, cameras: Cameras) -> list[Cameras]:
    """The part of each camera's image that Gaussians may reach; cameras that see none go."""
    crops = []
    for camera in cameras:
        low, high = pixel_bounds(splats, camera)
        low, high = (low - MARGIN).clamp(min=0), torch.minimum(high + MARGIN, camera.sizes[0])
        reached = (low < high).all(dim=1)
        if reached.any():
            low, high = low[reached].amin(dim=0), high[reached].amax(dim=0)
            crops.append(crop(camera, low.tolist(), (high - low).tolist()))
    return crops


def _find_outside(
    splats: Splats, mask: Bool[Tensor, " N"], cameras: Sequence[Cameras]
) -> list[Outside]:
    """The pixels of each camera that show nothing of an object, or haze away from its edge."""
    bare = without_looks(splats)
    own = bare[mask]
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * EDGE + 1, 2 * EDGE + 1))

    def look(camera: Cameras) -> Outside:
        covered = coverage(bare, camera, mask)
        alone = full_coverage(own, camera)  # whatever hides it
        solid = (alone > COVERED).numpy().astype(np.uint8)
        edge = torch.from_numpy(cv2.dilate(solid, disc)).bool()
        return camera, (covered == 0) | ((covered < FAINT) & ~edge), 0.0

    return [*per_view(look, cameras, "looking beside the object")]


def _find_covered(
    splats: Splats, mask: Bool[Tensor, " N"], cameras: Sequence[Cameras]
) -> list[Outside]:
    """The pixels of each camera that show protected Gaussians."""
    bare = without_looks(splats)

    def look(camera: Cameras) -> Outside:
        return camera, coverage(bare, camera, mask) > COVERED, SHINES

    return [*per_view(look, cameras, "looking at what is protected")]


def _overflow(
    canvas: Canvas, outside: Sequence[Outside]
) -> tuple[Int[Tensor, " M"], list[Outside]]:
    """The discs that show outside the object, and the pixels outside that they may uncover."""
    bare, is_disc = without_looks(canvas.splats), canvas.is_disc

    def look(view: Outside) -> Tensor:
        camera, pixels, most = view
        low, high = pixel_bounds(bare, camera)
        suspects = is_disc.nonzero()[:, 0]
        suspects = suspects[touching(low[suspects], high[suspects], pixels)]
        pixels = pixels & reached_pixels(bare[suspects], camera)
        if not pixels.any():
            return suspects[:0]
        there = touching(low, high, pixels).nonzero()[:, 0]
        seen = contributions(bare[there], camera, is_disc[there])
        return there[seen.gaussians[seen.weights(pixels) > most]]

    found = [*per_view(look, outside, "checking the outline")]
    uncovered = [
        (camera, pixels & reached_pixels(canvas.splats[rows], camera), most)
        for (camera, pixels, most), rows in zip(outside, found, strict=True)
        if len(rows)
    ]
    return torch.cat([NO_ROWS, *found]).unique(), uncovered


@torch.no_grad()
def reached_pixels(splats: Splats, camera: Cameras) -> Bool[Tensor, "H W"]:
    """The pixels in which some Gaussians would show if there were no others."""
    return full_coverage(without_looks(splats), camera) > 0

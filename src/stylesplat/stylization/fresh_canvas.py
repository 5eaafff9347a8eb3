"""A fresh canvas: small, round, evenly spread Gaussians on an object's surface.

An object's own pattern sits in the shapes of its Gaussians too, so that whatever colours they
take, it shows. The canvas hides them; they keep their places, and undoing gives them back.
"""

import math, os
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import contributions
from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.rendering.shares import COVERED, coverage, without_looks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import Box, around, typical_length
from stylesplat.stylization.overflow import beside
from stylesplat.stylization.refit import fit
from stylesplat.stylization.seen_surface import LENGTH, Surface, seen_surface
from stylesplat.stylization.split import FINE_ENOUGH, Split
from stylesplat.stylization.spread import POOLED, flattened, pooled, thinned

WIDE, FLAT = float(os.environ.get('WIDE', .7)), 0.15  # deviations of a disc in its plane and across, in distances of discs
FINER = float(os.environ.get('FINER', 1))
OPACITY = float(os.environ.get('OPAC', .95))  # of a disc before it is fitted
RATES = {"opacities": 0.1, "scales": 0.03, "sh0": 0.05}
STEPS = 60
BENEATH = (0.3, 0.6)  # parts of what a Gaussian paints beneath discs: none of it fades, and all
VIEWS = 12  # in which is looked for what lies beneath
SMALLER = 0.6  # of a disc that shows where nothing of the object showed, once
TRIES = 2


@torch.no_grad()
def fresh_canvas(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    cameras: Cameras,
    *,
    length: float,
    room: int,
    seed: int,
) -> Split:
    """Lay a canvas on an object, and fade what lies beneath.

    Args:
        splats: The scene, on the CPU.
        picked: The object's Gaussians.
        boxes: Where it is seen.
        cameras: Views in which nothing may show where nothing of the object showed.
        length: The object's longer side in pixels, for which the canvas is to be fine enough.
        room: How many Gaussians it may have.
        seed: Of their places, and of what they are fitted in.

    Returns:
        Each new Gaussian's parent is the picked one that is nearest.
    """
    surface = seen_surface(splats, picked, boxes)
    distance = FINER * FINE_ENOUGH / 0.7 * surface.pixel * LENGTH / length
    split = _laid(splats, picked, _discs(surface, distance, room, seed=seed))
    split = _hiding(splats, _within(splats, split, picked, cameras), picked, boxes)
    fitted = torch.arange(len(split.splats)) >= len(splats)
    split = fit(splats, split, picked, boxes, fitted, RATES, steps=STEPS, seed=seed)
    return _hiding(splats, _within(splats, split, picked, cameras), picked, boxes)


def _discs(surface: Surface, distance: float, room: int, *, seed: int) -> Splats:
    """Round Gaussians on a surface; farther from each other than wanted if there is no room."""
    while True:
        points, normals, colors = pooled(
            POOLED * distance, surface.points, [surface.normals, surface.colors]
        )
        points, normals = flattened(points, normals)
        rows = thinned(points, distance, seed=seed)
        if len(rows) <= room:
            break
        distance *= max(1.02, math.sqrt(len(rows) / room))
    scales = points.new_tensor([WIDE, WIDE, FLAT]).mul(distance).log()
    count = len(rows)
    return Splats(
        means=points[rows],
        quats=_facing(normals[rows]),
        scales=scales.expand(count, 3).clone(),
        opacities=torch.logit(points.new_full((count,), OPACITY)),
        sh0=sh0_from_rgb(colors[rows])[:, None],
        shN=points.new_zeros(count, 0, 3),
    )


def _facing(normals: Float[Tensor, "D 3"]) -> Float[Tensor, "D 4"]:
    """Rotations that turn the z axis to the normals."""
    x, y, z = normals.unbind(1)
    quats = torch.stack([1 + z, -y, x, torch.zeros_like(z)], dim=1)
    quats[z < -0.999] = quats.new_tensor([0.0, 1.0, 0.0, 0.0])
    return torch.nn.functional.normalize(quats, dim=1)


def _laid(splats: Splats, picked: Tensor, discs: Splats) -> Split:
    """The scene with discs, each of which takes after the nearest of the object's Gaussians."""
    own = picked.nonzero()[:, 0]
    _, nearest = KDTree(splats.means[own].double().numpy()).query(discs.means.double().numpy())
    parents = own[torch.from_numpy(nearest)]
    matte = splats.shN[parents] * 0
    laid = replace(splats[parents], **{**discs.tensors(), "shN": matte})
    tensors = {k: torch.cat([t, laid.tensors()[k]]) for k, t in splats.tensors().items()}
    return Split(replace(splats, **tensors), torch.cat([torch.arange(len(splats)), parents]))


def _hiding(splats: Splats, split: Split, picked: Tensor, boxes: Sequence[Box]) -> Split:
    """The same without what lies beneath the discs."""
    disc = torch.arange(len(split.splats)) >= len(splats)
    own = picked[split.parents] & ~disc
    bare, before = without_looks(split.splats[~own]), without_looks(splats)
    zoom = LENGTH / typical_length(boxes)
    cuts = [around(box, zoom, (1, 1))[0] for box in evenly(boxes, VIEWS)]

    def look(camera: Cameras) -> Tensor:
        hidden = coverage(bare, camera, disc[~own]) > COVERED
        view = contributions(before, camera, picked)
        sums = torch.stack([view.weights(hidden), view.weights()], dim=1)
        return sums.new_zeros(len(splats), 2).index_copy_(0, view.gaussians, sums)

    seen = track(at_once(look, cuts), "looking beneath the canvas", total=len(cuts))
    beneath, everywhere = sum(seen).unbind(dim=1)
    low, high = BENEATH
    fading = ((beneath / everywhere.clamp(min=1e-9) - low) / (high - low)).clamp(0, 1)
    fading = fading * picked
    faded = torch.logit(torch.sigmoid(splats.opacities) * (1 - fading), eps=1e-6)
    faded = torch.where(fading > 0, faded, splats.opacities)
    opacities = torch.cat([faded, split.splats.opacities[len(splats) :]])
    return replace(split, splats=replace(split.splats, opacities=opacities))


def _within(splats: Splats, split: Split, picked: Tensor, cameras: Cameras) -> Split:
    """The same with smaller discs, or none, where they show beside the object."""
    for attempt in range(TRIES + 1):
        rows = beside(splats, split, picked, cameras)
        rows = rows[rows >= len(splats)]
        if not len(rows):
            return split
        if attempt < TRIES:
            scales = split.splats.scales.clone()
            scales[rows] += math.log(SMALLER)
            split = replace(split, splats=replace(split.splats, scales=scales))
    kept = torch.ones(len(split.splats), dtype=torch.bool).index_fill(0, rows, False)
    return Split(split.splats[kept], split.parents[kept])

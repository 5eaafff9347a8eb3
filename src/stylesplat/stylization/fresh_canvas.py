"""A fresh canvas: small, round, evenly spread Gaussians on an object's surface.

An object's own pattern sits in the shapes of its Gaussians too, so that whatever colours they
take, it shows. The canvas hides them; they keep their places, and undoing gives them back.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
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
from stylesplat.stylization.evenly_spread import POOLED, flattened, pooled, thinned
from stylesplat.stylization.object_views import Box, around, typical_length
from stylesplat.stylization.overflow import NONE, Untouched, beside, cut_to, reached, untouched
from stylesplat.stylization.refit import fit
from stylesplat.stylization.seen_surface import LENGTH, Surface, seen_surface
from stylesplat.stylization.split import Split

CLOSE = 1.3  # pixels between discs: a stroke is several of them wide
WIDE, FLAT = 1.0, 0.15  # deviations of a disc in its plane and across it, in distances of discs
# Of a disc before it is fitted: more looks grainy, as then a pixel shows a single disc
OPACITY = 0.8
RATES = {"opacities": 0.1, "scales": 0.03, "sh0": 0.05}
STEPS = 60
BENEATH = (0.5, 0.9)  # part of what a Gaussian paints that discs hide: none of it fades, and all
VIEWS = 12  # in which is looked for what discs hide, and first for those that are too large
SMALLER = 0.6  # of a disc that shows where nothing of the object showed
FEW = 500  # pixels of all views that show no surface
CHECKED = 48  # views in which nothing may show beside the object: discs lie on its very outline
MARGIN = 16  # pixels around what the object may reach in them
SPARE = 0.9  # share of the room that is aimed at


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
) -> Split | None:
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
        Each new Gaussian's parent is the picked one that is nearest. None if the object has no
        surface that a canvas could lie on, as smoke has none.
    """
    surface = seen_surface(splats, picked, boxes)
    if len(surface.points) < FEW:
        return None
    distance = CLOSE * surface.pixel * LENGTH / length
    split = _laid(splats, picked, _discs(surface, distance, room, seed=seed))
    checked = cameras[[*evenly(range(len(cameras)), CHECKED)]]
    pixels = untouched(splats, picked, cut_to(splats[picked], checked, MARGIN))
    split, _ = _smaller(splats, split, picked, evenly(pixels, VIEWS))
    split = _hiding(splats, split, picked, boxes)
    fitted = torch.arange(len(split.splats)) >= len(splats)
    split = fit(splats, split, picked, boxes, fitted, RATES, steps=STEPS, seed=seed)
    return _hiding(splats, _within(splats, split, picked, pixels), picked, boxes)


def _discs(surface: Surface, distance: float, room: int, *, seed: int) -> Splats:
    """Round Gaussians on a surface; farther from each other than wanted if there is no room."""
    while True:
        known = [surface.normals, surface.colors]
        points, normals, colors = pooled(POOLED * distance, surface.points, known)
        rows = thinned(points, distance, seed=seed)
        if len(rows) <= room:
            break
        distance *= math.sqrt(len(rows) / (SPARE * room))
    means, normals = flattened(points, normals, rows)
    scales = points.new_tensor([WIDE, WIDE, FLAT]).mul(distance).log()
    count = len(rows)
    return Splats(
        means=means,
        quats=_facing(normals),
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
    beneath, everywhere = torch.stack([*seen]).sum(dim=0).unbind(dim=1)
    low, high = BENEATH
    fading = ((beneath / everywhere.clamp(min=1e-9) - low) / (high - low)).clamp(0, 1)
    fading = fading * picked
    faded = torch.logit(torch.sigmoid(splats.opacities) * (1 - fading), eps=1e-6)
    faded = torch.where(fading > 0, faded, splats.opacities)
    opacities = torch.cat([faded, split.splats.opacities[len(splats) :]])
    return replace(split, splats=replace(split.splats, opacities=opacities))


def _within(splats: Splats, split: Split, picked: Tensor, pixels: Sequence[Untouched]) -> Split:
    """The same with smaller discs, or none, where they show beside the object."""
    split, pixels = _smaller(splats, split, picked, pixels)
    while pixels:
        rows, pixels = _overflowing(splats, split, picked, pixels)
        kept = torch.ones_like(split.parents, dtype=torch.bool).index_fill(0, rows, False)
        split = Split(split.splats[kept], split.parents[kept])
    return split


def _smaller(
    splats: Splats, split: Split, picked: Tensor, pixels: Sequence[Untouched]
) -> tuple[Split, Sequence[Untouched]]:
    """The same with smaller discs where they show beside the object, and the pixels in which."""
    rows, pixels = _overflowing(splats, split, picked, pixels)
    scales = split.splats.scales.clone()
    scales[rows] += math.log(SMALLER)
    return replace(split, splats=replace(split.splats, scales=scales)), pixels


def _overflowing(
    splats: Splats, split: Split, picked: Tensor, pixels: Sequence[Untouched]
) -> tuple[Int[Tensor, " M"], Sequence[Untouched]]:
    """The discs that show where nothing may, and the pixels in which they may uncover others."""
    found = beside(split.splats, picked[split.parents], pixels)
    discs = [rows[rows >= len(splats)] for rows in found]
    shown = [
        (camera, nothing & reached(split.splats[rows], camera))
        for (camera, nothing), rows in zip(pixels, discs, strict=True)
        if len(rows)
    ]
    return torch.cat([NONE, *discs]).unique(), shown

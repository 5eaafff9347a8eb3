"""A canvas: small, evenly spread discs on an object's surface, which carry the strokes.

An object's own pattern sits in the shapes of its Gaussians too, so that whatever colours they
take, it shows. The canvas hides them; they keep their places, and undoing gives them back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from stylesplat.stylization.seen_surface import LENGTH, Surface, seen_surface
from stylesplat.stylization.strokes import align_to_strokes

CLOSE = 1.3  # pixels between discs: a stroke is several of them wide
WIDE, FLAT = 1.0, 0.15  # deviations of a disc in its plane and across it, in distances of discs
# Of a disc before it is fitted: more looks grainy, as then a pixel shows a single disc
OPACITY = 0.8
BENEATH = (0.5, 0.9)  # part of what a Gaussian paints that discs hide: none of it fades, and all
VIEWS = 12  # in which is looked for what discs hide
SMALLER = 0.6  # of a disc that shows where nothing of the object showed
FEW = 500  # pixels of all views that show no surface
CHECKED = 48  # views in which nothing may show beside the object: discs lie on its very outline
MARGIN = 16  # pixels around what the object may reach in them
SPARE = 0.9  # share of the room that is aimed at


@dataclass(frozen=True)
class Canvas:
    """A scene with discs on an object's surface, beneath which the object's Gaussians fade."""

    splats: Splats
    """Discs follow all other Gaussians."""
    parents: Int[Tensor, " N"]
    """The Gaussian of the scene before that each one comes from: of a disc, the nearest picked."""
    distance: float
    """Between neighbouring discs."""
    count: int
    """Gaussians of the scene before."""

    @property
    def discs(self) -> Bool[Tensor, " N"]:
        """Which of its Gaussians are discs."""
        return torch.arange(len(self.parents), device=self.parents.device) >= self.count


@torch.no_grad()
def lay_canvas(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    *,
    length: float,
    room: int,
    seed: int,
) -> Canvas | None:
    """Lay a canvas on an object, and fade what lies beneath.

    Args:
        splats: The scene, on the CPU.
        picked: The object's Gaussians.
        boxes: Where it is seen.
        length: The object's longer side in pixels, for which the canvas is to be fine enough.
        room: How many Gaussians it may have.
        seed: Of their places.

    Returns:
        The canvas, not fitted yet (see `fit_canvas`), which may show beside the object (see
        `confine_canvas`). None if the
        object has no surface that a canvas could lie on, as smoke has none.
    """
    surface = seen_surface(splats, picked, boxes)
    if len(surface.points) < FEW:
        return None
    distance = CLOSE * surface.pixel * LENGTH / length
    canvas = _laid(splats, picked, *_discs(surface, distance, room, seed=seed))
    return _hide_beneath(splats, canvas, picked, boxes)


@torch.no_grad()
def confine_canvas(
    splats: Splats,
    canvas: Canvas,
    picked: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    cameras: Cameras,
    *,
    along: Splats | None = None,
) -> tuple[Canvas, Bool[Tensor, " M"]]:
    """Let a canvas show nowhere beside the object, its discs turned along strokes first.

    Args:
        splats: The scene before, on the CPU.
        canvas: What was laid on it.
        picked: The object's Gaussians.
        boxes: Where the object is seen.
        cameras: Views in which nothing may show where nothing of the object showed.
        along: The same canvas with strokes to turn discs along; None leaves them round.

    Returns:
        The canvas, discs that showed beside the object smaller or gone, and which of its Gaussians
        are left.
    """
    round_ones = canvas.splats
    if along is not None:
        turned = align_to_strokes(along, canvas.discs, canvas.distance)
        turned = replace(round_ones, quats=turned.quats, scales=turned.scales)
        canvas = replace(canvas, splats=turned)
    checked = cameras[[*evenly(range(len(cameras)), CHECKED)]]
    pixels = untouched(splats, picked, cut_to(splats[picked], checked, MARGIN))
    rows, pixels = _overflowing(canvas, picked, pixels)
    scales = canvas.splats.scales.clone()
    scales[rows] = round_ones.scales[rows] + math.log(SMALLER)
    canvas = replace(canvas, splats=replace(canvas.splats, scales=scales))
    kept = torch.ones_like(canvas.discs)
    while pixels:
        left = kept.nonzero()[:, 0]
        part = replace(canvas, splats=canvas.splats[left], parents=canvas.parents[left])
        rows, pixels = _overflowing(part, picked, pixels)
        kept[left[rows]] = False
    left = kept.nonzero()[:, 0]
    canvas = replace(canvas, splats=canvas.splats[left], parents=canvas.parents[left])
    return _hide_beneath(splats, canvas, picked, boxes), kept


def _discs(surface: Surface, distance: float, room: int, *, seed: int) -> tuple[Splats, float]:
    """Discs on a surface, farther from each other than wanted if there is no room, and how far."""
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
    discs = Splats(
        means=means,
        quats=_facing(normals),
        scales=scales.expand(count, 3).clone(),
        opacities=torch.logit(points.new_full((count,), OPACITY)),
        sh0=sh0_from_rgb(colors[rows])[:, None],
        shN=points.new_zeros(count, 0, 3),
    )
    return discs, distance


def _facing(normals: Float[Tensor, "D 3"]) -> Float[Tensor, "D 4"]:
    """Rotations that turn the z axis to the normals."""
    x, y, z = normals.unbind(1)
    quats = torch.stack([1 + z, -y, x, torch.zeros_like(z)], dim=1)
    quats[z < -0.999] = quats.new_tensor([0.0, 1.0, 0.0, 0.0])
    return torch.nn.functional.normalize(quats, dim=1)


def _laid(splats: Splats, picked: Tensor, discs: Splats, distance: float) -> Canvas:
    """The scene with discs, each of which takes after the nearest of the object's Gaussians."""
    own = picked.nonzero()[:, 0]
    _, nearest = KDTree(splats.means[own].double().numpy()).query(discs.means.double().numpy())
    parents = own[torch.from_numpy(nearest)]
    matte = splats.shN[parents] * 0
    laid = replace(splats[parents], **{**discs.tensors(), "shN": matte})
    tensors = {k: torch.cat([t, laid.tensors()[k]]) for k, t in splats.tensors().items()}
    parents = torch.cat([torch.arange(len(splats)), parents])
    return Canvas(replace(splats, **tensors), parents, distance, len(splats))


def _hide_beneath(splats: Splats, canvas: Canvas, picked: Tensor, boxes: Sequence[Box]) -> Canvas:
    """The same without what lies beneath the discs."""
    own = picked[canvas.parents] & ~canvas.discs
    bare, before = without_looks(canvas.splats[~own]), without_looks(splats)
    zoom = LENGTH / typical_length(boxes)
    cuts = [around(box, zoom, (1, 1))[0] for box in evenly(boxes, VIEWS)]

    def look(camera: Cameras) -> Tensor:
        hidden = coverage(bare, camera, canvas.discs[~own]) > COVERED
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
    opacities = torch.cat([faded, canvas.splats.opacities[len(splats) :]])
    return replace(canvas, splats=replace(canvas.splats, opacities=opacities))


def _overflowing(
    canvas: Canvas, picked: Tensor, pixels: Sequence[Untouched]
) -> tuple[Int[Tensor, " M"], Sequence[Untouched]]:
    """The discs that show where nothing may, and the pixels in which they may uncover others."""
    found = beside(canvas.splats, picked[canvas.parents], pixels)
    discs = [rows[rows >= canvas.count] for rows in found]
    shown = [
        (camera, nothing & reached(canvas.splats[rows], camera))
        for (camera, nothing), rows in zip(pixels, discs, strict=True)
        if len(rows)
    ]
    return torch.cat([NONE, *discs]).unique(), shown

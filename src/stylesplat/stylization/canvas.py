"""A canvas: small, evenly spread discs on an object's surface, which carry the strokes.

The pattern of an object is in the shapes of its Gaussians, too: it shows whatever colours they
take. The canvas hides them. They keep their positions, and undoing gives them back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.linear import contributions
from stylesplat.rendering.shares import COVERED, coverage, without_looks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.stylization.surface import (
    LENGTH,
    POOLED,
    SurfacePoints,
    find_surface,
    pool_points,
    project_to_planes,
    thin,
)
from stylesplat.stylization.views import Box, crop_to_box, typical_length

SPACING = 1.3  # pixels between discs: a stroke is several of them wide
WIDE, FLAT = 1.0, 0.15  # deviations of a disc in its plane and across it, in spacings
OPACITY = 0.8  # of a disc before it is fitted: more looks grainy, as a pixel shows a single disc
HIDDEN = (0.5, 0.9)  # hidden part of a Gaussian's contribution from which it fades, and is gone
VIEWS = 12  # in which hidden Gaussians are looked for
HOLE_VIEWS = 16  # in which holes between the discs are looked for
LOST = 0.2  # coverage: where the object would lose more under a canvas, the canvas has a hole
RIM = 3  # pixels along the object's outline that are no holes
IN_HOLES = 0.05  # part of a Gaussian's contribution to a view that has to lie in holes
FEW = 500  # pixels of all views that show no surface
SPARE = 0.9  # share of the discs' maximum that is aimed at


@dataclass(frozen=True)
class Canvas:
    """A scene with discs on an object's surface, under which the object's Gaussians fade."""

    splats: Splats
    """The discs follow all other Gaussians."""
    parents: Int[Tensor, " N"]
    """The Gaussian of the scene before that each one belongs to: of a disc, the nearest."""
    spacing: float
    """The distance between neighbouring discs."""
    count: int
    """Gaussians of the scene before."""

    @property
    def is_disc(self) -> Bool[Tensor, " N"]:
        """Which of its Gaussians are discs."""
        return torch.arange(len(self.parents), device=self.parents.device) >= self.count

    def select(self, rows: Int[Tensor, " M"]) -> "Canvas":
        """The canvas with some of its Gaussians, all of the scene before among them."""
        return replace(self, splats=self.splats[rows], parents=self.parents[rows])


@torch.no_grad()
def lay_canvas(
    splats: Splats,
    mask: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    *,
    length: float,
    max_discs: int,
    seed: int,
) -> Canvas | None:
    """Lay a canvas on an object, and fade the Gaussians under it.

    Args:
        splats: The scene, on the CPU.
        mask: The object's Gaussians.
        boxes: Where it is seen.
        length: The object's longer side in pixels that discs are to be fine enough for.
        max_discs: The maximum number of discs.
        seed: Of their positions.

    Returns:
        The canvas, not fitted yet (`fit_canvas`), which may show beside the object
        (`confine_canvas`). None if the object has no surface, as smoke has none.
    """
    surface = find_surface(splats, mask, boxes)
    if len(surface.points) < FEW:
        return None
    spacing = SPACING * surface.pixel * LENGTH / length
    discs, spacing = _make_discs(surface, spacing, max_discs, seed=seed)
    own = mask.nonzero()[:, 0]
    _, nearest = KDTree(splats.means[own].double().numpy()).query(discs.means.double().numpy())
    parents = own[torch.from_numpy(nearest)]
    laid = replace(splats[parents], **{**discs.tensors(), "shN": splats.shN[parents] * 0})
    parents = torch.cat([torch.arange(len(splats)), parents])
    canvas = Canvas(Splats.cat([splats, laid]), parents, spacing, len(splats))
    return fade_hidden(splats, canvas, mask, boxes)


def _make_discs(
    surface: SurfacePoints, spacing: float, max_discs: int, *, seed: int
) -> tuple[Splats, float]:
    """Discs on a surface, at a larger spacing where there would be too many, and the spacing."""
    while True:
        values = [surface.normals, surface.colors]
        points, normals, colors = pool_points(POOLED * spacing, surface.points, values)
        rows = thin(points, spacing, seed=seed)
        if len(rows) <= max_discs:
            break
        spacing *= math.sqrt(len(rows) / (SPARE * max_discs))
    means, normals = project_to_planes(points, normals, rows)
    scales = points.new_tensor([WIDE, WIDE, FLAT]).mul(spacing).log()
    count = len(rows)
    discs = Splats(
        means=means,
        quats=_facing(normals),
        scales=scales.expand(count, 3).clone(),
        opacities=torch.logit(points.new_full((count,), OPACITY)),
        sh0=sh0_from_rgb(colors[rows])[:, None],
        shN=points.new_zeros(count, 0, 3),
    )
    return discs, spacing


def _facing(normals: Float[Tensor, "D 3"]) -> Float[Tensor, "D 4"]:
    """Rotations that turn the z axis to the normals."""
    x, y, z = normals.unbind(1)
    quats = torch.stack([1 + z, -y, x, torch.zeros_like(z)], dim=1)
    quats[z < -0.999] = quats.new_tensor([0.0, 1.0, 0.0, 0.0])
    return torch.nn.functional.normalize(quats, dim=1)


@torch.no_grad()
def fade_hidden(
    splats: Splats, canvas: Canvas, mask: Bool[Tensor, " N"], boxes: Sequence[Box]
) -> Canvas:
    """Fade the object's Gaussians as far as the discs hide them.

    Args:
        splats: The scene before.
        canvas: The scene with discs.
        mask: The object's Gaussians.
        boxes: Where it is seen.
    """
    own = mask[canvas.parents] & ~canvas.is_disc
    bare, before = without_looks(canvas.splats[~own]), without_looks(splats)
    zoom = LENGTH / typical_length(boxes)
    cameras = [crop_to_box(box, zoom, (1, 1))[0] for box in evenly(boxes, VIEWS)]

    def look(camera: Cameras) -> Tensor:
        hidden = coverage(bare, camera, canvas.is_disc[~own]) > COVERED
        view = contributions(before, camera, mask)
        sums = torch.stack([view.weights(hidden), view.weights()], dim=1)
        return sums.new_zeros(len(splats), 2).index_copy_(0, view.gaussians, sums)

    found = track(at_once(look, cameras), "looking under the canvas", total=len(cameras))
    hidden, everywhere = torch.stack([*found]).sum(dim=0).unbind(dim=1)
    low, high = HIDDEN
    fading = ((hidden / everywhere.clamp(min=1e-9) - low) / (high - low)).clamp(0, 1) * mask
    faded = torch.logit(torch.sigmoid(splats.opacities) * (1 - fading), eps=1e-6)
    faded = torch.where(fading > 0, faded, splats.opacities)
    opacities = torch.cat([faded, canvas.splats.opacities[len(splats) :]])
    return replace(canvas, splats=replace(canvas.splats, opacities=opacities))


@torch.no_grad()
def fill_holes(
    splats: Splats, canvas: Canvas, mask: Bool[Tensor, " N"], boxes: Sequence[Box]
) -> Canvas:
    """Give the Gaussians that show in holes between the discs their opacity back.

    Args:
        splats: The scene before.
        canvas: The scene with discs, its hidden Gaussians faded.
        mask: The object's Gaussians.
        boxes: Where it is seen.
    """
    faded, before = without_looks(canvas.splats), without_looks(splats)
    zoom = LENGTH / typical_length(boxes)
    cameras = [crop_to_box(box, zoom, (1, 1))[0] for box in evenly(boxes, HOLE_VIEWS)]

    def look(camera: Cameras) -> Tensor:
        view = contributions(before, camera, mask)
        lost = view.coverage - coverage(faded, camera, mask[canvas.parents]) > LOST
        covered = (view.coverage > COVERED).numpy().astype(np.uint8)
        inner = torch.from_numpy(cv2.erode(covered, np.ones((2 * RIM + 1, 2 * RIM + 1)))).bool()
        return view.gaussians[view.weights(lost & inner) > IN_HOLES * view.weights()]

    found = track(at_once(look, cameras), "looking for holes of the canvas", total=len(cameras))
    rows = torch.cat([*found])
    opacities = canvas.splats.opacities.clone()
    opacities[rows] = splats.opacities[rows]
    return replace(canvas, splats=replace(canvas.splats, opacities=opacities))

"""Discs turned along the strokes of the paint, and confined to where the object showed."""

import math
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.imaging.color import LUMA
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.visibility import pixel_bounds, touching
from stylesplat.rendering.weights import COVERED, contributions, coverage, geometry_only
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import UNSEEN
from stylesplat.scene.projection import crop
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.stylization.canvas import Canvas, fade_covered, restore_in_holes
from stylesplat.stylization.views import per_view

SPILL_VIEWS = 24  # that are checked: discs lie on the very outline of the object
SPILL_COARSER = 2.0  # ratio of the photos' size to that of the check: finds the same as full size
LEAST_SIZE = 480  # pixels of the check's longer side, so that small photos are checked in full
SPILL_MARGIN = 16  # pixels around what the object may reach in them
SPILL_FAINT = 0.1  # coverage: less is haze, unless it is the soft edge
SPILL_EDGE = 2  # pixels around what is covered that are its edge
SMALLER = 0.6  # factor on the size of a disc that shows beside the object
SPILL_NEIGHBOURS = 32  # discs that gradients and structure tensors are averaged over
GRADIENT_WIDTH = 1.5  # deviation of the weights of a gradient's fit, in distances between discs
TENSOR_WIDTH = 2.5  # and of the average of structure tensors
SPILL_RIDGE = 1e-3  # of the fit, for discs whose neighbours lie on a line
LONG, NARROW = 1.8, 0.6  # factors on scales along and across a stroke; 2.5 spikes the silhouette
SHINES = 0.1  # pixels of a disc that shine through what is protected, if that lies before it


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
) -> tuple[Canvas, Bool[Tensor, " M"]]:
    """Turn the discs of a canvas along the strokes, and let none show beside the object.

    Discs that show beside it in a camera become smaller; those that still do are removed. Without
    the canvas painted in the colours of the strokes, discs stay round. Nor may discs show on what
    is protected of the Gaussians before. Returns also which Gaussians of the canvas are left.
    """
    splats, round_discs = canvas.before, canvas.splats
    if painted is not None:
        turned = align_to_strokes(painted, canvas.is_disc, canvas.spacing)
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
    # what removed discs hid comes back; thin parts are all rim, in which no holes are looked for
    return restore_in_holes(fade_covered(canvas.select(kept))), kept


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
            crops.append(crop(camera, low.tolist(), (high - low).tolist()))
    return crops


def _find_outside(
    splats: Splats, mask: Tensor, protected: Tensor | None, cameras: Sequence[Cameras]
) -> list[ForbiddenPixels]:
    """Where there is nothing of an object, haze away from its edge, or what is protected."""
    bare = geometry_only(splats)
    own = bare[mask]
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SPILL_EDGE + 1, 2 * SPILL_EDGE + 1))

    def look(camera: Cameras) -> list[ForbiddenPixels]:
        covered = coverage(bare, camera, mask)
        alone = coverage(own, camera)  # whatever hides it
        solid = (alone > COVERED).cpu().numpy().astype(np.uint8)
        edge = torch.from_numpy(cv2.dilate(solid, disc)).bool().to(covered.device)
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


def reached_pixels(splats: Splats, camera: Cameras) -> Bool[Tensor, "H W"]:
    """The pixels in which some Gaussians would show if there were no others."""
    return coverage(geometry_only(splats), camera) > 0


@torch.no_grad()
def align_to_strokes(splats: Splats, discs: Bool[Tensor, " N"], distance: float) -> Splats:
    """Turn discs along the strokes painted so far, and stretch them.

    In each disc's tangent plane the structure tensor of the painted luminance gives the direction
    (the eigenvector of its smaller eigenvalue) and how coherent it is (Weickert 1999). The third
    axis of a disc is its normal, the distance that between neighbouring discs.
    """
    rows = discs.nonzero()[:, 0]
    means, axes = splats.means[rows], rotation_matrices(splats.quats[rows])
    tangents, normals = axes[:, :, :2], axes[:, :, 2]
    points = means.double().cpu().numpy()
    far, near = KDTree(points).query(points, k=min(SPILL_NEIGHBOURS, len(rows)), workers=-1)
    far = torch.from_numpy(far).to(means).view(len(rows), -1) / distance
    near = torch.from_numpy(near).to(rows).view(len(rows), -1)
    same_side = (normals[near] * normals[:, None]).sum(dim=2).clamp(min=0)  # [D, k]

    def weights(width: float) -> Tensor:
        return same_side * (-(far / width).square() / 2).exp()

    luma = splats.sh0[rows, 0] @ splats.sh0.new_tensor(LUMA)
    gradients = _gradients(means / distance, tangents, luma, near, weights(GRADIENT_WIDTH))
    local = torch.einsum("dij,dki->dkj", tangents, gradients[near])
    tensors = torch.einsum("dk,dki,dkj->dij", weights(TENSOR_WIDTH), local, local)
    # The eigenvectors in closed form: cuSOLVER takes few matrices at once
    twice, sums = 2 * tensors[:, 0, 1], tensors[:, 0, 0] + tensors[:, 1, 1]
    apart = tensors[:, 0, 0] - tensors[:, 1, 1]
    coherence = torch.hypot(apart, twice) / sums.clamp(min=1e-12)
    half = (torch.atan2(twice, apart) + math.pi) / 4  # of the angle to the smaller one's
    stretch = 1 + torch.stack(
        [(LONG - 1) * coherence, (NARROW - 1) * coherence, 0 * coherence], dim=1
    )
    turned = {
        "quats": _turned_in_plane(splats.quats[rows], half.cos(), half.sin()),
        "scales": splats.scales[rows] + stretch.log(),
    }
    return splats.with_rows(rows, turned)


def _gradients(
    points: Float[Tensor, "D 3"],
    tangents: Float[Tensor, "D 3 2"],
    values: Float[Tensor, " D"],
    near: Tensor,
    weights: Float[Tensor, "D k"],
) -> Float[Tensor, "D 3"]:
    """Gradients along the surface, by a weighted fit of a plane to each point's neighbours."""
    total = weights.sum(dim=1, keepdim=True).clamp(min=1e-9)
    offsets = torch.einsum("dki,dij->dkj", points[near] - points[:, None], tangents)
    offsets = offsets - ((weights[..., None] * offsets).sum(dim=1) / total)[:, None]
    changes = values[near] - (weights * values[near]).sum(dim=1, keepdim=True) / total
    normal = torch.einsum("dk,dki,dkj->dij", weights, offsets, offsets)
    right = torch.einsum("dk,dki,dk->di", weights, offsets, changes)
    fitted = torch.linalg.solve(normal + SPILL_RIDGE * torch.eye(2).to(points), right)
    return torch.einsum("dij,dj->di", tangents, fitted)


def _turned_in_plane(
    quats: Float[Tensor, "D 4"], cos: Float[Tensor, " D"], sin: Float[Tensor, " D"]
) -> Float[Tensor, "D 4"]:
    """Rotations after one about their own third axis, by twice the angle of `cos` and `sin`."""
    w, x, y, z = quats.unbind(1)
    turned = [w * cos - z * sin, x * cos + y * sin, y * cos - x * sin, z * cos + w * sin]
    return torch.stack(turned, dim=1)

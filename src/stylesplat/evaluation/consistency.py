"""View consistency of a painted object: views are warped onto each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import depths_of, project, unproject
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.views import Box, find_boxes

RANGES = {"short": 1, "long": 7}  # steps between the views of a pair, as papers measure it
MAX_PAIRS = 4  # per range
LONGER_SIDE = 320  # pixels; of the renders that are compared
OCCLUDED = 0.02  # relative difference of depth: a larger one means another surface


@dataclass(frozen=True, eq=False)
class ObjectRender:
    """The render of an object in one view, before and after it is painted."""

    camera: Cameras
    colors: Float[Tensor, "H W 6"]
    """The base scene's and the styled scene's colours, in 0..1."""
    surface: Float[Tensor, "H W 2"]
    """The object's coverage, and its depth times coverage: a sum that may be interpolated."""


@torch.no_grad()
def view_consistency(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
    *,
    boxes: Sequence[Box] | None = None,
) -> dict[str, float]:
    """Compare the colours of the same surface points of an object between views.

    Papers on 3D style transfer warp one view to another and report the masked RMSE, between
    neighbours and between views farther apart (StyleGaussian, Liu et al. 2024). Here depth
    rendered from the Gaussians stands in for the optical flow. Errors of that depth, highlights
    and the resampling of fine texture count too, hence the same numbers of the base scene.

    Returns:
        `short_range_rmse` and `long_range_rmse` of the styled scene, and both with `_base` of
        the other; a range whose views share no visible surface is left out.
    """
    boxes = boxes or find_boxes(base, cameras, picked)
    pairs = {name: view_pairs(len(boxes), gap) for name, gap in RANGES.items()}
    rows = {row for some in pairs.values() for pair in some for row in pair}
    renders = {row: _render_object(base, styled, boxes[row].camera, picked) for row in rows}
    found = {}
    for name, some in pairs.items():
        differences = [warped_difference(renders[a], renders[b]) for a, b in some]
        if any(len(d) for d in differences):
            squares = torch.cat(differences).square().mean(dim=0)  # of the pixels of all pairs
            before, after = squares.view(2, 3).mean(dim=1).sqrt().tolist()
            found |= {f"{name}_range_rmse": after, f"{name}_range_rmse_base": before}
    return found


def view_pairs(count: int, gap: int) -> list[tuple[int, int]]:
    """Up to `MAX_PAIRS` pairs of `count` views, `gap` apart or else as far as there are views."""
    gap = min(gap, count - 1)
    return evenly([(i, i + gap) for i in range(count - gap)], MAX_PAIRS) if gap > 0 else []


def warped_difference(a: ObjectRender, b: ObjectRender) -> Float[Tensor, "P 6"]:
    """Colours of the object in `a` warped to `b` minus those in `b`, where both show the point."""
    mask = b.surface[..., 0] > COVERED
    coverage, summed = b.surface[mask].unbind(-1)
    pixels = mask.nonzero().flip(1) + 0.5  # x, y
    places, depths = project(unproject(pixels, summed / coverage, b.camera), a.camera)
    size = torch.tensor(a.camera.size).to(places)
    inside = (places >= 0).all(dim=1) & (places <= size).all(dim=1)
    found, surface = _sample(a.colors, places), _sample(a.surface, places)
    coverage, summed = surface.unbind(-1)
    # What lies behind the camera has a negative depth, which no rendered one is near.
    same_surface = (summed - depths * coverage).abs() <= OCCLUDED * depths * coverage
    return (found - b.colors[mask])[inside & (coverage > COVERED) & same_surface]


def _render_object(
    base: Splats, styled: Splats, camera: Cameras, picked: Bool[Tensor, " N"]
) -> ObjectRender:
    small = camera.at_most(LONGER_SIDE).to(base.device)
    share = picked.to(base.means)
    features = torch.stack([share, share * depths_of(base.means, small)], dim=1)
    before, _ = render(base, small, features=features)
    after, _ = render(styled, small)
    colors = torch.cat([before[..., :3], after], dim=-1).clamp(0, 1)
    return ObjectRender(small, colors, before[..., 3:])


def _sample(image: Float[Tensor, "H W D"], places: Float[Tensor, "P 2"]) -> Float[Tensor, "P D"]:
    """Sample bilinearly; pixel centres are at +0.5, and the border continues outwards."""
    height, width = image.shape[:2]
    grid = 2 * places / places.new_tensor([width, height]) - 1
    planes = image.permute(2, 0, 1)[None]
    sampled = F.grid_sample(planes, grid[None, None], padding_mode="border", align_corners=False)
    return sampled[0, :, 0].T

"""What painting changed beside the painted objects, and whether neighbouring views agree."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt, label
from torch import Tensor
from torch.nn import functional as F

from stylesplat.imaging.morphology import disc
from stylesplat.imaging.similarity import decibels
from stylesplat.rendering.render import render
from stylesplat.rendering.weights import (
    COVERED,
    colors_and_coverage,
    composite,
    coverage,
    pixels_in,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, Mask, resize_labels
from stylesplat.scene.projection import depths_of, project, unproject
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import evenly_spaced, farthest_views
from stylesplat.scene.splats import Splats
from stylesplat.selection.resolve import whole_ids
from stylesplat.stylization.views import ObjectBox, find_boxes

RANGES = {"short": 1, "long": 7}  # steps between the views of a pair, as papers measure it
CHANGE_MAX_PAIRS = 4  # per range
CHANGE_LONGER_SIDE = 320  # pixels; of the renders that are compared
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
    boxes: Sequence[ObjectBox] | None = None,
) -> dict[str, float]:
    """Compare the colours of the same surface points of an object between views.

    Papers on 3D style transfer warp one view to another and report the masked RMSE, between
    neighbours and between views farther apart (StyleGaussian, Liu et al. 2024). Here depth
    rendered from the Gaussians stands in for the optical flow. Errors of that depth, highlights
    and the resampling of fine texture count too, hence the same numbers of the base scene.
    Returns `short_range_rmse` and `long_range_rmse` of the styled scene, and both with `_base` of
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
    """Some pairs of `count` views, `gap` apart or else as far as there are views."""
    gap = min(gap, count - 1)
    pairs = [(i, i + gap) for i in range(count - gap)] if gap > 0 else []
    return evenly_spaced(pairs, CHANGE_MAX_PAIRS)


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
    small = camera.at_most(CHANGE_LONGER_SIDE).to(base.device)
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


CHANGED = 0.05  # of a channel's range: a larger change of a pixel is visible
MEASURED_VIEWS = 4
STAIN_VIEWS = 16  # with label maps that contain a painted object
ERROR = 0.01  # of a view's longer side: error of an object's border in a label map
LEAST_ERROR = 3  # pixels
# Pixels by which a stain is thicker than that error, as the edges of splats are soft
CHANGE_SOFT = 2
LEAST_AREA = 48  # pixels: smaller areas are specks
CHANGE_MOST = 0.5  # share of the label maps in which a place has to lie beside the objects


@torch.no_grad()
def measure_changes(
    base: Splats, styled: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]
) -> dict[str, int | float]:
    """Compare at most 4 renders before and after where the painted Gaussians are not visible.

    The scene after may have more Gaussians at its end.

    Returns:
        `changed_gaussians`, new ones included; `painted_gaussians` and `changed_outside`, those of
        the picked and of all others that differ; `outside_psnr` (120 at most) and
        `outside_max_difference` over pixels that none of them touches.
    """
    outside = []
    for row in evenly_spaced(range(len(cameras)), MEASURED_VIEWS):
        camera = cameras[row]
        before, covered = colors_and_coverage(base, camera, picked)
        difference = render(styled, camera)[0].clamp(0, 1) - before.clamp(0, 1)
        outside.append(difference[covered[..., 0] == 0].flatten())
    changed = torch.zeros_like(picked)
    for name, old in base.tensors().items():
        new = styled.tensors()[name][: len(base)]
        changed |= (old != new)[:, None].flatten(1).any(dim=1)
    difference = torch.cat(outside)
    return {
        "changed_gaussians": int(changed.sum()) + len(styled) - len(base),
        "painted_gaussians": int((changed & picked).sum()),
        "changed_outside": int((changed & ~picked).sum()),
        "outside_psnr": float(decibels(difference.square().sum() / max(1, len(difference)))),
        "outside_max_difference": float(difference.abs().max()) if len(difference) else 0.0,
    }


@torch.no_grad()
def largest_stain(
    before: Scene, after: Scene, names: Sequence[str], capture: Capture, device: torch.device
) -> dict[str, int | str]:
    """Find the largest changed area beside the painted objects in up to 16 views.

    Label maps err: by a few pixels at the borders of objects, in some views by whole parts. So a
    pixel counts if it changed, lies farther from the objects in its view's label map than borders
    err, and shows a place that most label maps leave out. Thin rims and specks do not count.
    Returns `stain_pixels`, at the size that the scene was made at, 0 if there is no stain; and the
    name of its view, `stain_view`, if there is one. Empty if no label map shows an object.
    """
    base, styled = before.splats.to(device), after.splats.to(device)
    cameras = after.cameras.downscale(after.downscale)
    ids = {name: whole_ids(before, name) for name in names}
    layers = {layer.object: layer for layer in after.layers}
    picks = {name: layers[name].covered(len(base)).to(device) for name in names}
    beside = dict(islice(_beside(base, cameras, capture, ids, picks), STAIN_VIEWS))
    if not beside:
        return {}
    masks = (torch.stack([~mask, mask], dim=-1) for mask in beside.values())
    on, off = pixels_in(base, cameras[[*beside]], masks).split(1, dim=1)
    left_out = off / (on + off).clamp(min=torch.finfo(off.dtype).tiny)
    stains = {}
    for row, mask in beside.items():
        camera = cameras[row]
        pair = (render(each, camera)[0].clamp(0, 1) for each in (base, styled))
        changed = torch.sub(*pair).abs().amax(dim=-1) > CHANGED
        elsewhere = composite(base, camera, left_out)[..., 0] > CHANGE_MOST
        stains[camera.names[0]] = largest_area(mask & (changed & elsewhere).cpu())
    view = max(stains, key=lambda name: stains[name])
    found: dict[str, int | str] = {"stain_pixels": stains[view]}
    return found | ({"stain_view": view} if stains[view] else {})


def _beside(
    base: Splats,
    cameras: Cameras,
    capture: Capture,
    ids: Mapping[str, Sequence[int]],
    picks: Mapping[str, Bool[Tensor, " N"]],
) -> Iterator[tuple[int, Mask]]:
    """Rows of cameras far from each other, and the pixels beside all objects in each."""
    photos = {name: row for row, name in enumerate(capture.cameras.names)}
    for row in farthest_views(cameras, len(cameras)):
        photo = photos.get(cameras.names[row])
        labels = None if photo is None else capture.labels(photo)
        if labels is None:
            continue
        labels = resize_labels(labels, cameras[row].size[::-1])
        masks = {name: torch.isin(labels, labels.new_tensor(some)) for name, some in ids.items()}
        if any(mask.any() for mask in masks.values()):
            for name, mask in masks.items():
                if not mask.any():
                    masks[name] = (coverage(base, cameras[row], picks[name]) > 0).cpu()
            mask = torch.stack([*masks.values()]).any(dim=0)
            yield row, farther_than(mask, float(_error(mask)))


def largest_area(stained: Mask) -> int:
    """Pixels of the largest connected area that is neither a thin rim nor a speck, or 0."""
    kernel = disc(_error(stained) + CHANGE_SOFT)
    narrow = binary_erosion(stained.numpy(), kernel, border_value=1)
    parts = np.empty(stained.shape, np.int32)
    label(binary_dilation(narrow, kernel), np.ones((3, 3)), output=parts)
    area = int(np.bincount(parts.ravel())[1:].max(initial=0))
    return area if area >= LEAST_AREA else 0


def _error(mask: Mask) -> int:
    """The error in pixels that borders of a label map of this size may have."""
    return max(LEAST_ERROR, round(ERROR * max(mask.shape)))


def farther_than(mask: Mask, reach: float) -> Mask:
    """The pixels of the picture that lie farther than `reach` pixels from all pixels of a mask."""
    if not mask.any():
        return torch.ones_like(mask)
    distances = np.asarray(distance_transform_edt((~mask).cpu().numpy()))
    return torch.from_numpy(distances > reach).to(mask.device)

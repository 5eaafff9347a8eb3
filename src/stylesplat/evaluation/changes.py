"""What painting changed besides the painted objects: pixels outside of them, and stains."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.metrics.images import decibels
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import (
    colors_and_coverage,
    coverage,
    label_votes,
    render_shares,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import mask_of
from stylesplat.scene.labels import Mask, resize_labels
from stylesplat.scene.sampling import evenly, far_apart
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.selection.choose import whole_ids

CHANGED = 0.05  # of a channel's range: a larger change of a pixel is visible
MEASURED_VIEWS = 4
STAIN_VIEWS = 16  # with label maps that contain a painted object
ERROR = 0.01  # of a view's longer side: error of an object's border in a label map
LEAST_ERROR = 3  # pixels
SOFT = 2  # pixels by which a stain is thicker than that error, as the edges of splats are soft
LEAST_AREA = 48  # pixels: smaller areas are specks
MOST = 0.5  # share of the label maps in which a place has to lie beside the objects


@torch.no_grad()
def measure_changes(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
) -> dict[str, int | float]:
    """Compare at most 4 renders before and after where the painted Gaussians are not visible.

    The scene after may have more Gaussians at its end.

    Returns:
        `changed_gaussians`, new ones included; `painted_gaussians` and `changed_outside`, those of
        the picked and of all others that differ; `outside_psnr` (120 at most) and
        `outside_max_difference` over pixels that none of them touches.
    """
    outside = []
    for row in evenly(range(len(cameras)), MEASURED_VIEWS):
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

    Returns:
        `stain_pixels`, at the size that the scene was made at, 0 if there is no stain; and the
        name of its view, `stain_view`, if there is one. Empty if no label map shows an object.
    """
    base, styled = before.splats.to(device), after.splats.to(device)
    cameras = after.cameras.downscale(after.downscale)
    ids = {name: whole_ids(before, name) for name in names}
    layers = {layer.object: layer for layer in after.layers}
    picks = {name: mask_of(layers[name], before).to(device) for name in names}
    beside = dict(islice(_beside(base, cameras, capture, ids, picks), STAIN_VIEWS))
    if not beside:
        return {}
    _, votes = label_votes(base, cameras, ((row, mask.long()) for row, mask in beside.items()))
    table = votes.toarray()  # of each Gaussian: its pixels on the objects, and beside them
    totals = np.maximum(table.sum(axis=1, keepdims=True), np.finfo(table.dtype).tiny)
    left_out = torch.from_numpy(table[:, 1:].sum(axis=1, keepdims=True) / totals).to(device)
    stains = {}
    for row, mask in beside.items():
        camera = cameras[row]
        pair = (render(each, camera)[0].clamp(0, 1) for each in (base, styled))
        changed = torch.sub(*pair).abs().amax(dim=-1) > CHANGED
        elsewhere = render_shares(base, camera, left_out)[..., 0] > MOST
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
    """Yield rows of cameras far from each other, and the pixels beside all objects in each.

    Where a label map lacks an object, its rendered mask is used.
    """
    photos = {name: row for row, name in enumerate(capture.cameras.names)}
    for row in far_apart(cameras, len(cameras)):
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
    side = _error(stained) + SOFT
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    opened = cv2.morphologyEx(stained.numpy().astype(np.uint8), cv2.MORPH_OPEN, disc)
    _, _, stats, _ = cv2.connectedComponentsWithStats(opened)
    area = int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))
    return area if area >= LEAST_AREA else 0


def _error(mask: Mask) -> int:
    """The error in pixels that borders of a label map of this size may have."""
    return max(LEAST_ERROR, round(ERROR * max(mask.shape)))


def farther_than(mask: Mask, reach: float) -> Mask:
    """The pixels of the picture that lie farther than `reach` pixels from all pixels of a mask."""
    if not mask.any():
        return torch.ones_like(mask)
    outside = (~mask).cpu().numpy().astype(np.uint8)
    distances = cv2.distanceTransform(outside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return torch.from_numpy(distances > reach).to(mask.device)

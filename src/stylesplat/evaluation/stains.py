"""Stains: what changed beside the painted objects, whose places in photos label maps tell."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.metrics.masked_change import CHANGED, farther_than
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import coverage, label_votes, render_shares
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import mask_of
from stylesplat.scene.labels import Mask, resize_labels
from stylesplat.scene.sampling import far_apart
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.selection.choose import whole_ids

VIEWS = 16  # that show a painted object in their label maps
ERROR = 0.01  # of a view's longer side: how far the border of an object in a label map may err
LEAST_ERROR = 3  # pixels
SOFT = 2  # pixels that a stain is thicker than that error at least: what splats cover ends softly
LEAST_AREA = 48  # pixels: less is a speck
MOST = 0.5  # of the label maps that show a place


@torch.no_grad()
def largest_stain(
    before: Scene, after: Scene, names: Sequence[str], capture: Capture, device: torch.device
) -> dict[str, int | str]:
    """Find the largest changed place beside painted objects in any of some views.

    Label maps err: by a few pixels at the borders of objects, in some views by whole parts. So a
    pixel counts if it changed, lies farther from the objects in its view's label map than borders
    err, and shows a place that most label maps leave out. Thin rims and specks do not count.

    Args:
        before: The scene before the objects were painted.
        after: The painted scene.
        names: The painted objects.
        capture: The photos, with label maps if there are any.
        device: Where to render.

    Returns:
        `stain_pixels`, at the size that the scene was made at, 0 if there is no stain; and the
        name of its view, `stain_view`, if there is one. Empty if no label map shows an object.
    """
    base, styled = before.splats.to(device), after.splats.to(device)
    cameras = after.cameras.downscale(after.downscale)
    ids = {name: whole_ids(before, name) for name in names}
    layers = {layer.object: layer for layer in after.layers}
    picks = {name: mask_of(layers[name], before).to(device) for name in names}
    beside = dict(islice(_beside(base, cameras, capture, ids, picks), VIEWS))
    if not beside:
        return {}
    _, votes = label_votes(base, cameras, ((row, mask.long()) for row, mask in beside.items()))
    left_out = torch.from_numpy(_share_left_out(votes.toarray())).to(device)
    stains = {}
    for row, mask in beside.items():
        camera = cameras[row]
        pair = (render(each, camera)[0].clamp(0, 1) for each in (base, styled))
        changed = torch.sub(*pair).abs().amax(dim=-1) > CHANGED
        elsewhere = render_shares(base, camera, left_out)[..., 0] > MOST
        stains[camera.names[0]] = _largest_area(mask & (changed & elsewhere).cpu())
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
    """Rows of some cameras, far from each other, and the pixels beside all objects in each.

    Objects that a label map does not know are where they are rendered.
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


def _share_left_out(votes: Float[np.ndarray, "N K"]) -> Float[np.ndarray, "N 1"]:
    """Of the pixels that a Gaussian makes up, those beside the objects; 0 if it shows in none."""
    beside = votes[:, 1:].sum(axis=1, keepdims=True)
    return beside / np.maximum(votes.sum(axis=1, keepdims=True), np.finfo(votes.dtype).tiny)


def _largest_area(stained: Mask) -> int:
    """Pixels of the largest connected place that is neither a thin rim nor a speck; 0 without."""
    side = _error(stained) + SOFT
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    opened = cv2.morphologyEx(stained.numpy().astype(np.uint8), cv2.MORPH_OPEN, disc)
    _, _, stats, _ = cv2.connectedComponentsWithStats(opened)
    area = int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))
    return area if area >= LEAST_AREA else 0


def _error(mask: Mask) -> int:
    """By how many pixels the borders of a label map of that size may err."""
    return max(LEAST_ERROR, round(ERROR * max(mask.shape)))

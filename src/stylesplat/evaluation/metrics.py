"""How close renders are to the photos, and rendered labels to the given ones."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from tqdm import tqdm

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.scene.capture import BACKGROUND, Capture
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import render_labels
from stylesplat.training.ssim import ssim

BOUNDARY = 0.02  # of the image's diagonal: what counts as near a contour


def psnr(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Peak signal-to-noise ratio in decibels of images in 0..1; infinite if they are equal."""
    return -10 * (image - target).square().mean().log10()


LabelPairs = Iterable[tuple[Int[Tensor, "H W"], Int[Tensor, "H W"]]]
"""Predicted and given label map of each view."""


def object_iou(pairs: LabelPairs, *, boundary: bool = False) -> dict[int, float]:
    """Intersection over union of predicted and given label maps, by object.

    Args:
        pairs: Label maps; pixels are pooled over the views.
        boundary: Compare only the pixels within 2% of the image's diagonal from each one's
            contour (Boundary IoU, Cheng et al. 2021).

    Returns:
        A number for every id that occurs on either side, background left out.
    """
    intersections: dict[int, int] = {}
    unions: dict[int, int] = {}
    for predicted, given in pairs:
        ids = {*predicted.unique().tolist(), *given.unique().tolist()} - {BACKGROUND}
        for id in ids:
            here, there = predicted == id, given == id
            if boundary:
                here, there = _band(here), _band(there)
            intersections[id] = intersections.get(id, 0) + int((here & there).sum())
            unions[id] = unions.get(id, 0) + int((here | there).sum())
    return {id: intersections[id] / unions[id] for id in sorted(unions)}


def _band(mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """The pixels of a mask that are near its contour; the image's border counts as outside."""
    width = max(1, round(BOUNDARY * math.hypot(*mask.shape)))
    padded = np.pad(mask.numpy().astype(np.uint8), 1)
    inner = cv2.erode(padded, np.ones((3, 3), np.uint8), iterations=width)[1:-1, 1:-1]
    return mask & ~torch.from_numpy(inner).bool()


@torch.no_grad()
def evaluate_views(
    splats: Splats, capture: Capture, rows: Sequence[int], *, backend: Backend = "auto"
) -> dict[str, Any]:
    """Compare renders with photos, and rendered label maps with the given ones.

    Args:
        splats: The Gaussians.
        capture: Photos and their cameras.
        rows: Which views to compare; the held-out ones, usually.
        backend: See `rasterize`.

    Returns:
        `psnr` and `ssim`, averaged over the views. If the splats have identities and these views
        have label maps, also `iou` and `boundary_iou` by label id, and their means over the
        objects, `miou` and `boundary_miou`.

    Raises:
        StyleSplatError: If `rows` is empty.
    """
    if not rows:
        raise StyleSplatError(
            "There are no held-out views to evaluate. Train with `--test-every 8`."
        )
    scores = []
    for row in tqdm(rows, desc="evaluate", unit="view"):
        image, _, _ = rasterize(splats, capture.cameras[row], backend=backend)
        photo = capture.photos[row].to(image) / 255
        image = image[0].clamp(0, 1)
        scores.append(torch.stack([psnr(image, photo), ssim(image, photo)]))
    means = torch.stack(scores).mean(dim=0)
    metrics: dict[str, Any] = {"psnr": means[0].item(), "ssim": means[1].item()}
    pairs = list(_label_pairs(splats, capture, rows, backend))
    if pairs:
        for prefix, boundary in (("", False), ("boundary_", True)):
            by_id = object_iou(pairs, boundary=boundary)
            metrics[f"{prefix}iou"] = by_id
            metrics[f"{prefix}miou"] = sum(by_id.values()) / max(len(by_id), 1)
    return metrics


def _label_pairs(
    splats: Splats, capture: Capture, rows: Sequence[int], backend: Backend
) -> Iterable[tuple[Tensor, Tensor]]:
    if splats.classifier is None or capture.label_maps is None:
        return
    for row in rows:
        given = capture.label_maps[row]
        if given is not None:
            yield render_labels(splats, capture.cameras[row], backend=backend).cpu(), given

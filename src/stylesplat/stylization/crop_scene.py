"""The part of a large scene that an object is painted in: its Gaussians, and all that show near it.

The whole scene is rendered once per view. After that painting takes as long as in a small scene.
"""

from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from stylesplat.rendering.shares import coverage, without_looks
from stylesplat.rendering.visibility import LARGE, in_view, visible
from stylesplat.scene.cameras import Cameras
from stylesplat.stylization.confine import reached_pixels
from stylesplat.stylization.target import PaintContext, PaintTarget
from stylesplat.stylization.views import per_view

VISIBLE = 0.02  # share of some pixel: an object with less in a view is hidden, but for seams
MARGIN = 24  # pixels around what it may reach: in smaller renders Gaussians grow by as much


@torch.no_grad()
def crop_scene(
    context: PaintContext, target: PaintTarget
) -> tuple[PaintContext, PaintTarget, Int[Tensor, " M"]]:
    """Crop a large scene to the Gaussians and views that matter to an object.

    Besides the object's Gaussians these are all that would show near it if it were not there: what
    hides it, and what it hides. In views that hide the object some of these may be missing, so that
    they are left out. A small scene stays whole, and one of which no view shows the object.

    Returns:
        The context and the target in the crop, and the crop's rows of the scene.
    """
    splats, views = context.splats, [*context.all_cameras]
    everything = context, target, torch.arange(len(splats), device=splats.device)
    names = {*context.all_cameras.names}
    if len(splats) < LARGE or splats.device.type != "cpu" or len(names) < len(views):
        return everything
    bare, own = without_looks(splats), target.mask.nonzero()[:, 0]
    others = replace(bare, opacities=bare.opacities.masked_fill(target.mask, -torch.inf))
    alone, square = bare[own], np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)

    def look(view: Cameras) -> Tensor | None:
        """The Gaussians that would show near the object; None if it is hidden."""
        near = reached_pixels(alone, view)
        if not near.any():
            return None
        near = torch.from_numpy(cv2.dilate(near.numpy().astype(np.uint8), square)).bool()
        rows = visible(in_view(others, view, near), view).rows
        there = torch.cat([own, rows])
        shares = coverage(bare[there], view, torch.arange(len(there)) < len(own))
        return rows if (shares > VISIBLE).any() else None

    kept, shown = target.mask.clone(), set[str]()
    found = per_view(look, views, "looking around the object")
    for view, rows in zip(views, found, strict=True):
        if rows is not None:
            kept[rows] = True
            shown.update(view.names)
    if shown.isdisjoint(context.cameras.names):
        return everything
    rows = kept.nonzero()[:, 0]
    cameras, all_cameras = (
        each[[n for n, name in enumerate(each.names) if name in shown]]
        for each in (context.cameras, context.all_cameras)
    )
    part = replace(context, splats=splats[rows], cameras=cameras, all_cameras=all_cameras)
    protected = None if target.protected is None else target.protected[rows]
    return part, replace(target, mask=target.mask[rows], protected=protected), rows

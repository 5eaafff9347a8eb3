"""Where to cut a view into before and after, so that no painted object is cut."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.rendering.shares import coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import MIN_COVERAGE


@torch.no_grad()
def quiet_cut(splats: Splats, camera: Cameras, objects: Sequence[Bool[Tensor, " N"]]) -> float:
    """The upright line that cuts least of some objects, with at least one on each side.

    Args:
        splats: The scene.
        camera: One camera.
        objects: The Gaussians of each; those that the camera does not see count for nothing.

    Returns:
        Its place, 0 to 1 from the left; that of a single object is beside it.
    """
    shown = [coverage(splats, camera, picked) > MIN_COVERAGE for picked in objects]
    columns = torch.stack([mask.sum(dim=0).float().cpu() for mask in shown])  # [objects, W]
    columns = columns[columns.sum(dim=1) > 0]
    if not len(columns):
        return 0.5
    places = torch.arange(columns.shape[1])
    middles = (columns * places).sum(dim=1) / columns.sum(dim=1)
    crossed = columns.sum(dim=0)
    if len(columns) > 1:
        between = (places >= middles.min()) & (places <= middles.max())
        crossed = crossed.where(between, math.inf)
    return (int(crossed.argmin()) + 0.5) / len(places)

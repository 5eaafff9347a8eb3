"""Whether a pick stands before something, as objects do, or is a piece of the background.

What is behind an object shows along its outline: there the depth jumps. A piece of a backdrop or a
wall ends where something nearer hides it, or nowhere.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED, TINY_COVERAGE
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import depths_of
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.shapes import extent
from stylesplat.selection.soft_picks import sampled_views

VIEWS = 6
WIDTH = 2  # pixels on either side of an outline
FARTHER = 0.04  # of the pick's extent, by which depths at an outline jump


@torch.no_grad()
def occluding_share(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> float:
    """The share of a pick's outlines in a few views that something farther, or nothing, is beside.

    On the fox, the picture on its wall and the demo's objects .08 to .89, on pieces of walls and of
    the demo's curved backdrop .00; 1 for what fills all views, 0 for what no view shows.
    """
    ring = np.ones((2 * WIDTH + 1, 2 * WIDTH + 1), np.uint8)
    farther, whole, shown = 0, 0, 0
    jump = FARTHER * extent(splats.means[picked]) if picked.any() else 0.0
    for camera in evenly(sampled_views(cameras), VIEWS):
        features = torch.stack([depths_of(splats.means, camera), picked.to(splats.means)], dim=1)
        image, alphas = render(splats, camera, features=features, sh_degree=0)
        depths = (image[..., 3] / alphas[..., 0].clamp(min=TINY_COVERAGE)).numpy()
        inside = (image[..., 4] > COVERED).numpy()
        beside = (cv2.dilate(inside.astype(np.uint8), ring) > 0) & ~inside
        own = cv2.dilate(np.where(inside, depths, 0).astype(np.float32), ring)
        empty = (alphas[..., 0] < COVERED).numpy()
        farther += int((beside & ((depths > own + jump) | empty)).sum())
        whole += int(beside.sum())
        shown += int(inside.sum())
    return farther / whole if whole else float(shown > 0)

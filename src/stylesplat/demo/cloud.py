"""Sparse coloured points of a scene, as structure from motion would find them."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.demo.still_life import View
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import pixel_centres, unproject

NOISE = 1.5e-3  # standard deviation of a point, as a fraction of its depth
PLAIN = 0.15  # how likely a point is where the photo is plain, relative to its mean contrast


def surface_points(
    cameras: Cameras, views: Sequence[View], count: int, *, seed: int = 0
) -> tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]]:
    """Sample visible surface points with a little noise, more of them where photos have detail.

    Args:
        cameras: One per view.
        views: What the cameras see.
        count: How many points to take, in equal parts from all views.
        seed: Of the choice of pixels and the noise.

    Returns:
        The points and their sRGB colours.
    """
    rng = np.random.default_rng(seed)
    positions, colors = [], []
    for i, view in enumerate(views):
        share = count * (i + 1) // len(views) - count * i // len(views)
        pixels = torch.from_numpy(_detailed_pixels(view.photo.numpy(), share, rng))
        noise = torch.from_numpy(rng.normal(0, NOISE, (share, 3)).astype(np.float32))
        depths = view.depth.flatten()[pixels]
        places = pixel_centres(*cameras[i].size)[pixels]
        positions.append(unproject(places, depths, cameras[i]) + noise * depths[:, None])
        colors.append(view.photo.reshape(-1, 3)[pixels])
    return torch.cat(positions), torch.cat(colors)


def _detailed_pixels(
    photo: UInt8[np.ndarray, "H W 3"], count: int, rng: np.random.Generator
) -> np.ndarray:
    """Flat indices of pixels, drawn in proportion to local contrast."""
    grey = photo.mean(axis=-1, dtype=np.float32)
    contrast = np.abs(grey - cv2.GaussianBlur(grey, (0, 0), 2))
    chance = (contrast + PLAIN * contrast.mean() + 1e-6).ravel().astype(np.float64)
    return rng.choice(chance.size, count, replace=count > chance.size, p=chance / chance.sum())

"""What every backend shares: activated Gaussians, one camera, projected Gaussians, and constants.

The CPU kernels take these nouns with arrays in the place of tensors.
"""

from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

EVERYONE = slice(None)

# The numbers that define what a rendered image is. All are gsplat 1.5.3's.
EPS2D = 0.3  # variance in square pixels added to every projected Gaussian: a low-pass filter
NEAR_PLANE = 0.01  # Gaussians nearer than this are not drawn
FAR_PLANE = 1e10  # nor those farther
MIN_ALPHA = 1 / 255  # fainter contributions are skipped
MAX_ALPHA = 0.999  # the clamp of version 1.5; the backward pass divides by 1 - alpha
MIN_TRANSMITTANCE = 1e-4  # a pixel is finished before it becomes darker than this
MAX_EXTENT = 3.33  # standard deviations at which a Gaussian of opacity 1 falls below MIN_ALPHA
MAX_RADIUS = 1 << 30  # pixels: radii are int32
FOV_MARGIN = 0.3  # how far outside the image, in half fields of view, the Jacobian is exact
LARGEST_SCALE = 23.0  # logarithm: squares of a standard deviation of 1e10 in pixels fit float32


class Gaussians(NamedTuple):
    """Activated splats."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    """wxyz, any norm."""
    scales: Float[Tensor, "N 3"]
    """Standard deviations along the axes."""
    opacities: Float[Tensor, " N"]
    """From 0 to 1."""
    antialiased: bool = False
    """Whether projection scales opacities by how much the low-pass filter enlarges a Gaussian."""


class View(NamedTuple):
    viewmat: Float[Tensor, "4 4"]
    K: Float[Tensor, "3 3"]
    width: int
    height: int


class Projected(NamedTuple):
    """Gaussians in the pixels of one camera."""

    means2d: Float[Tensor, "N 2"]
    conics: Float[Tensor, "N 3"]
    """Inverse covariances: xx, xy, yy."""
    opacities: Float[Tensor, " N"]
    """Those of the Gaussians; of antialiased ones as this camera sees them."""
    depths: Float[Tensor, " N"]
    radii: Int[Tensor, "N 2"]
    """Whole pixels in x and y; 0 for Gaussians out of view."""


def views_of(cameras: Cameras) -> list[View]:
    """The cameras one by one; they share an image size."""
    matrices = zip(cameras.viewmats, cameras.Ks, strict=True)
    return [View(viewmat, K, *cameras.size) for viewmat, K in matrices]


def activated(splats: Splats, part: slice = EVERYONE) -> Gaussians:
    """The Gaussians of splats, or of a part of them, as renderers take them."""
    scales = splats.scales[part].clamp(max=LARGEST_SCALE).exp()
    opacities = torch.sigmoid(splats.opacities[part])
    places = splats.means[part], splats.quats[part]
    return Gaussians(*places, scales, opacities, splats.antialiased)


def with_matrices_of(splats: Splats, cameras: Cameras) -> Cameras:
    """The cameras with matrices of the splats' type and device."""
    viewmats, Ks = cameras.viewmats.to(splats.means), cameras.Ks.to(splats.means)
    return replace(cameras, viewmats=viewmats, Ks=Ks)

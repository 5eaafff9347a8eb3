"""What every backend is given and what it makes of it: Gaussians, one camera, what that sees.

The CPU kernels take these nouns with arrays in the place of tensors.
"""

from typing import NamedTuple

from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.scene.cameras import Cameras


class Gaussians(NamedTuple):
    """Splats, activated."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    """wxyz, any norm."""
    scales: Float[Tensor, "N 3"]
    """Standard deviations along the axes."""
    opacities: Float[Tensor, " N"]
    """From 0 to 1."""


class View(NamedTuple):
    """One camera."""

    viewmat: Float[Tensor, "4 4"]
    K: Float[Tensor, "3 3"]
    width: int
    height: int


class Projected(NamedTuple):
    """What one camera sees of Gaussians, in pixels."""

    means2d: Float[Tensor, "N 2"]
    conics: Float[Tensor, "N 3"]
    """Inverse covariances: xx, xy, yy."""
    depths: Float[Tensor, " N"]
    radii: Int[Tensor, "N 2"]
    """Whole pixels in x and y; 0 for Gaussians that the camera does not see."""


def views_of(cameras: Cameras) -> list[View]:
    """The cameras one by one; they share an image size."""
    matrices = zip(cameras.viewmats, cameras.Ks, strict=True)
    return [View(viewmat, K, *cameras.size) for viewmat, K in matrices]

"""Structural similarity (Wang et al. 2004), as the 3D Gaussian splatting code computes it."""

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import conv2d

WINDOW = 11  # pixels
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2


@lru_cache
def ssim_window() -> Float[Tensor, " 11"]:
    """The normalised 1D Gaussian that SSIM averages with."""
    x = torch.arange(WINDOW) - WINDOW // 2
    window = torch.exp(-(x**2) / (2 * SIGMA**2))
    return window / window.sum()


def ssim(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Mean structural similarity of two images in 0..1, zero-padded as in the 3DGS code."""
    return ssim_map(image.permute(2, 0, 1), target.permute(2, 0, 1)).mean()


def ssim_map(
    image: Float[Tensor, "D H W"], target: Float[Tensor, "D H W"]
) -> Float[Tensor, "D H W"]:
    """The structural similarity around each pixel, channel by channel."""
    window = ssim_window().to(image)

    def blur(stack: Tensor) -> Tensor:
        rows = conv2d(stack, window.view(1, 1, -1, 1), padding=(WINDOW // 2, 0))
        return conv2d(rows, window.view(1, 1, 1, -1), padding=(0, WINDOW // 2))

    x, y = image[:, None], target[:, None]  # [D, 1, H, W]
    mean_x, mean_y, xx, yy, xy = (blur(t) for t in (x, y, x * x, y * y, x * y))
    var_x, var_y, covar = xx - mean_x**2, yy - mean_y**2, xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return (luminance * (2 * covar + C2) / (var_x + var_y + C2))[:, 0]

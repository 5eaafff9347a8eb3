"""Peak signal-to-noise ratio."""

from jaxtyping import Float
from torch import Tensor

SMALLEST_ERROR = 1e-12  # a mean square below float32's rounding counts as this: 120 dB


def psnr(image: Float[Tensor, "..."], target: Float[Tensor, "..."]) -> Float[Tensor, ""]:
    """Peak signal-to-noise ratio in decibels of images in 0..1, 120 at most."""
    return decibels((image - target).square().mean())


def decibels(error: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """A mean squared error of images in 0..1 as PSNR."""
    return -10 * error.clamp(min=SMALLEST_ERROR).log10()

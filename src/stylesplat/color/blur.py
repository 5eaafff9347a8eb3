"""Gaussian blurs of images."""

from functools import lru_cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

LEAST_DEVIATION = 0.5  # pixels of a blur's deviation; less blurs nothing
KEPT = 256  # matrices of 30 views of as many sizes, four deviations each: 64 MB at 250 pixels


def smooth(
    values: Float[Tensor, "*B H W"], mask: Bool[Tensor, "H W"], deviation: float
) -> Float[Tensor, "*B H W"]:
    """A Gaussian blur of values inside a mask, to which what lies outside adds nothing."""
    if deviation < LEAST_DEVIATION:
        return values * mask
    inside = mask.to(values)
    return inside * blur(values * inside, deviation) / blur(inside, deviation).clamp(min=1e-3)


def blur(values: Float[Tensor, "*B H W"], deviation: float) -> Float[Tensor, "*B H W"]:
    """A Gaussian blur with zeros around, of no particular sum: two products of matrices."""
    height, width = values.shape[-2:]
    rows, columns = (
        blur_matrix(size, deviation, values.device).to(values) for size in (height, width)
    )
    return rows @ values @ columns


@lru_cache(maxsize=KEPT)
@torch.inference_mode(False)  # else training could not use them later
def blur_matrix(size: int, deviation: float, device: torch.device) -> Float[Tensor, "S S"]:
    """The weight of each place along an axis in the blur of each other."""
    places = torch.arange(size, dtype=torch.float32, device=device)
    return (-((places[:, None] - places) / deviation).square() / 2).exp()

"""How close images and masks are: blurs, PSNR, SSIM, intersection over union."""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import minimum_filter
from torch import Tensor
from torch.nn.functional import conv2d

from stylesplat.scene.capture import BACKGROUND, Mask

LEAST_DEVIATION = 0.5  # pixels of a blur's deviation; less blurs nothing
BLUR_LEAST = 1e-9  # of a blur: denormal numbers make its products nine times slower
# Matrices of 30 views of as many sizes, four deviations each: 64 MB at 250 pixels
SIMILARITY_KEPT = 256


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


def blurs(
    values: Float[Tensor, "*B H W"], deviations: tuple[float, ...]
) -> Float[Tensor, "L *B H W"]:
    """Blurs of several deviations, as `blur`; less than `LEAST_DEVIATION` blurs nothing."""
    height, width = values.shape[-2:]
    rows, columns = (
        _blur_matrices(size, deviations, values.device)
        .view(-1, *[1] * (values.ndim - 2), size, size)
        .to(values)
        for size in (height, width)
    )
    return rows @ values.expand(len(deviations), *values.shape) @ columns


@lru_cache(maxsize=SIMILARITY_KEPT)
@torch.inference_mode(False)
def _blur_matrices(
    size: int, deviations: tuple[float, ...], device: torch.device
) -> Float[Tensor, "L S S"]:
    nothing = torch.eye(size, device=device)
    matrices = [
        nothing if each < LEAST_DEVIATION else blur_matrix(size, each, device)
        for each in deviations
    ]
    return torch.stack(matrices)


@lru_cache(maxsize=SIMILARITY_KEPT)
@torch.inference_mode(False)  # else training could not use them later
def blur_matrix(size: int, deviation: float, device: torch.device) -> Float[Tensor, "S S"]:
    """The weight of each place along an axis in the blur of each other."""
    places = torch.arange(size, dtype=torch.float32, device=device)
    weights = (-((places[:, None] - places) / deviation).square() / 2).exp()
    return weights.where(weights > BLUR_LEAST, 0)


SMALLEST_ERROR = 1e-12  # a mean square below float32's rounding counts as this: 120 dB
# SSIM after Wang et al. 2004, as the 3D Gaussian splatting code computes it
SSIM_WINDOW = 11  # pixels
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2


def psnr(image: Float[Tensor, "..."], target: Float[Tensor, "..."]) -> Float[Tensor, ""]:
    """Peak signal-to-noise ratio in decibels of images in 0..1, 120 at most."""
    return decibels((image - target).square().mean())


def decibels(error: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """A mean squared error of images in 0..1 as PSNR."""
    return -10 * error.clamp(min=SMALLEST_ERROR).log10()


@lru_cache
@torch.inference_mode(False)  # else training could not use them later
def ssim_window(device: torch.device) -> Float[Tensor, " 11"]:
    """Weights of the Gaussian window of SSIM, which sum to 1."""
    x = torch.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    window = torch.exp(-(x**2) / (2 * SIGMA**2))
    return (window / window.sum()).to(device)


def ssim(
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    valid: Bool[Tensor, "H W"] | None = None,
) -> Float[Tensor, ""]:
    """Mean structural similarity of two images in 0..1, zero-padded as in the 3DGS code.

    Of the valid pixels, if some are not: in the windows around them the others are black.
    """
    x, y = (each.permute(2, 0, 1) for each in (image, target))
    if valid is None:
        return ssim_map(x, y).mean()
    return ssim_map(x * valid, y * valid)[:, valid].mean()


def ssim_map(
    image: Float[Tensor, "D H W"], target: Float[Tensor, "D H W"]
) -> Float[Tensor, "D H W"]:
    """The structural similarity around each pixel, channel by channel."""
    x, y = image.contiguous(), target.contiguous()
    maps = torch.cat([x, y, x * x, y * y, x * y])[None]  # [1, 5 D, H, W]
    count, window = maps.shape[1], ssim_window(image.device).to(image)
    # One group per map: on a GPU, cuDNN would round what goes into other convolutions to TF32
    rows = window.view(1, 1, -1, 1).expand(count, -1, -1, -1)
    columns = window.view(1, 1, 1, -1).expand(count, -1, -1, -1)
    maps = conv2d(maps, rows, padding=(SSIM_WINDOW // 2, 0), groups=count)
    maps = conv2d(maps, columns, padding=(0, SSIM_WINDOW // 2), groups=count)
    mean_x, mean_y, xx, yy, xy = maps[0].chunk(5)
    var_x, var_y, covar = xx - mean_x**2, yy - mean_y**2, xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return luminance * (2 * covar + C2) / (var_x + var_y + C2)


BOUNDARY = 0.02  # of the image's diagonal: width of the band along a contour

LabelPairs = Iterable[tuple[Int[Tensor, "H W"], Int[Tensor, "H W"]]]
"""Predicted and given label map of each view."""


def mask_iou(one: Bool[Tensor, "..."], other: Bool[Tensor, "..."]) -> float:
    """IoU of two masks; 1 if both are empty."""
    either = int((one | other).sum())
    return int((one & other).sum()) / either if either else 1.0


def pairwise_iou(some: Sequence[Mask], others: Sequence[Mask]) -> Float[Tensor, "A B"]:
    """IoU of each mask of `some` with each of `others`, all of one size; 0 if both are empty."""
    if not some or not others:
        return torch.zeros(len(some), len(others))
    a, b = (torch.stack([*each]).flatten(1).float() for each in (some, others))
    both = a @ b.T
    return both / (a.sum(dim=1)[:, None] + b.sum(dim=1) - both).clamp(min=1)


def object_iou(pairs: LabelPairs, *, boundary: bool = False) -> dict[int, float]:
    """IoU of predicted and given label maps, by object.

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


def _band(mask: Mask) -> Mask:
    """The pixels of a mask that are near its contour; the image's border counts as outside."""
    width = max(1, round(BOUNDARY * math.hypot(*mask.shape)))
    inner = minimum_filter(np.pad(mask.numpy(), 1), 2 * width + 1)[1:-1, 1:-1]
    return mask & ~torch.from_numpy(inner)

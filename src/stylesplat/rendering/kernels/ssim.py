"""The photometric loss on the CPU: value and gradient in two passes of separable filters.

Images are rows of 3 W numbers inside a frame of zeros (SSIM's padding), so that vectors of 16 may
be read anywhere. Tested against `losses.photometric_reference`.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

from typing import NamedTuple

import numba
import numpy as np
import torch
from numba import get_num_threads
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn.functional import pad

from stylesplat.imaging.similarity import C1, C2, SSIM_WINDOW, ssim_window
from stylesplat.rendering.kernels import vec
from stylesplat.rendering.kernels.jit import inner, kernel

CHANNELS = 3
HALF = SSIM_WINDOW // 2  # rows of the frame above and below
MARGIN = HALF * CHANNELS  # numbers of the frame at the left
FRAME = -(-2 * MARGIN // vec.LANES) * vec.LANES  # of both ends, in whole vectors


class Pair(NamedTuple):
    """SSIM's window; the render and the photo in their frames, flat; the length of their rows."""

    window: np.ndarray
    x: np.ndarray
    y: np.ndarray
    stride: int


def pad_for_ssim(image: Tensor, stride: int) -> np.ndarray:
    """An image [H, W, 3] in a frame of zeros, flat."""
    rows = image.detach().float().flatten(1)
    behind = stride - rows.shape[1] - MARGIN
    return pad(rows, (MARGIN, behind, HALF, HALF)).view(-1).numpy()


@inner
def filter_columns_products(window, x, y, row, stride, out):
    """Filter x, y, x x, y y and x y along y at one row, into the five rows of `out`."""
    for j in range(0, stride, vec.LANES):
        mean_x, mean_y = vec.zero(), vec.zero()
        xx, yy, xy = vec.zero(), vec.zero(), vec.zero()
        for tap in range(SSIM_WINDOW):
            at, weight = (row + tap) * stride + j, vec.spread(window, tap)
            u, v = vec.load_vec(x, at), vec.load_vec(y, at)
            weighted_u, weighted_v = weight * u, weight * v
            mean_x, mean_y = mean_x + weighted_u, mean_y + weighted_v
            xx, xy = vec.fma(weighted_u, u, xx), vec.fma(weighted_u, v, xy)
            yy = vec.fma(weighted_v, v, yy)
        vec.store_vec(out, j, mean_x)
        vec.store_vec(out, stride + j, mean_y)
        vec.store_vec(out, 2 * stride + j, xx)
        vec.store_vec(out, 3 * stride + j, yy)
        vec.store_vec(out, 4 * stride + j, xy)


@inner
def filter_columns(window, framed, row, stride, out):
    """Filter a framed image along y at one row."""
    for j in range(0, stride, vec.LANES):
        total = vec.zero()
        for tap in range(SSIM_WINDOW):
            at = (row + tap) * stride + j
            total = vec.fma(vec.load_vec(framed, at), vec.spread(window, tap), total)
        vec.store_vec(out, j, total)


@inner
def filter_rows(window, row, start):
    """Filter 16 numbers of a framed row along x."""
    total = vec.zero()
    for tap in range(SSIM_WINDOW):
        number = vec.load_vec(row, start + tap * CHANNELS)
        total = vec.fma(number, vec.spread(window, tap), total)
    return total


@inner
def similarity(mean_x, mean_y, xx, yy, xy):
    """SSIM from blurred x, y and products; its gradients by blurred x, x x and x y."""
    var_x, var_y = xx - mean_x * mean_x, yy - mean_y * mean_y
    a = vec.fma(2 * mean_x, mean_y, C1)
    b = vec.fma(2, xy - mean_x * mean_y, C2)
    c = vec.fma(mean_x, mean_x, vec.fma(mean_y, mean_y, C1))
    d = var_x + var_y + C2
    inverse = vec.reciprocal(c * d)
    value = a * b * inverse
    v_xx, v_xy = 0 - value * (inverse * c), 2 * a * inverse
    v_mean = 2 * (mean_y * b * inverse - mean_x * value * (inverse * d))
    return value, v_mean - 2 * mean_x * v_xx - mean_y * v_xy, v_xx, v_xy


@kernel
def forward(pair, inside, v_maps, totals):
    """Add up each thread's SSIM, absolute and squared error (of x clamped to 0..1) in `totals`.

    Fills the gradients of SSIM by the three blurred maps, one framed image after the other.
    `inside` is 1 for the numbers of a row and 0 behind them.
    """
    window, x, y, stride = pair
    height = x.shape[0] // stride - 2 * HALF
    threads = totals.shape[0]
    for thread in numba.prange(threads):
        blurred, lanes = np.zeros(5 * stride, np.float32), np.empty(3 * vec.LANES, np.float32)
        for row in range(thread * height // threads, (thread + 1) * height // threads):
            filter_columns_products(window, x, y, row, stride, blurred)
            ssim, absolute, squared = vec.zero(), vec.zero(), vec.zero()
            for j in range(0, stride - FRAME, vec.LANES):
                value, v_mean, v_xx, v_xy = similarity(
                    filter_rows(window, blurred, j),
                    filter_rows(window, blurred, stride + j),
                    filter_rows(window, blurred, 2 * stride + j),
                    filter_rows(window, blurred, 3 * stride + j),
                    filter_rows(window, blurred, 4 * stride + j),
                )
                at, mask = (row + HALF) * stride + MARGIN + j, vec.load_vec(inside, j)
                vec.store_vec(v_maps, at, v_mean * mask)
                vec.store_vec(v_maps, at + x.shape[0], v_xx * mask)
                vec.store_vec(v_maps, at + 2 * x.shape[0], v_xy * mask)
                u, v = vec.load_vec(x, at), vec.load_vec(y, at)
                difference = vec.minimum(vec.maximum(u, 0), 1) - v
                ssim = vec.fma(value, mask, ssim)
                absolute = absolute + vec.absolute(u - v)
                squared = vec.fma(difference, difference, squared)
            vec.store_vec(lanes, 0, ssim)
            vec.store_vec(lanes, vec.LANES, absolute)
            vec.store_vec(lanes, 2 * vec.LANES, squared)
            for k in range(3 * vec.LANES):
                totals[thread, k // vec.LANES] += lanes[k]


@kernel
def backward(pair, v_maps, factors, v_x, threads):
    """Fill the gradient [H, 3W] of the first image: the filter is its own adjoint."""
    window, x, y, stride = pair
    v_ssim, v_absolute = factors
    height, n = v_x.shape
    for thread in numba.prange(threads):
        blurred = np.zeros(3 * stride, np.float32)
        gradient = np.empty(stride, np.float32)
        for row in range(thread * height // threads, (thread + 1) * height // threads):
            for k in range(3):
                v_map = v_maps[k * x.shape[0] : (k + 1) * x.shape[0]]
                filter_columns(window, v_map, row, stride, blurred[k * stride :])
            for j in range(0, stride - FRAME, vec.LANES):
                at = (row + HALF) * stride + MARGIN + j
                u, v = vec.load_vec(x, at), vec.load_vec(y, at)
                total = 2 * u * filter_rows(window, blurred, stride + j)
                total = vec.fma(v, filter_rows(window, blurred, 2 * stride + j), total)
                total = v_ssim * (total + filter_rows(window, blurred, j))
                sign = vec.select(vec.greater(u, v), v_absolute, -v_absolute)
                vec.store_vec(gradient, j, total + vec.select(vec.equal(u, v), 0, sign))
            for j in range(n):
                v_x[row, j] = gradient[j]


class Photometric(Function):
    """L1 and D-SSIM, weighted, and the squared error; gradients reach the image only."""

    @staticmethod
    def forward(ctx, image, target, dssim_weight):
        height, n = len(image), image[0].numel()
        stride = -(-n // vec.LANES) * vec.LANES + FRAME  # whole vectors, and the frame
        x, y = pad_for_ssim(image, stride), pad_for_ssim(target, stride)
        inside = np.zeros(stride, np.float32)
        inside[:n] = 1
        v_maps = np.zeros(3 * len(x), np.float32)
        window = ssim_window(torch.device("cpu")).numpy()
        pair = Pair(window, x, y, stride)
        totals = np.zeros((get_num_threads(), 3))
        forward(pair, inside, v_maps, totals)
        sums = totals.sum(axis=0) / (height * n)
        ctx.pair, ctx.v_maps = pair, v_maps
        ctx.shape, ctx.dssim_weight = image.shape, dssim_weight
        loss = (1 - dssim_weight) * sums[1] + dssim_weight * (1 - sums[0])
        error = image.new_tensor(sums[2])
        ctx.mark_non_differentiable(error)
        return image.new_tensor(loss), error

    @staticmethod
    @once_differentiable
    def backward(ctx, v_loss, v_error):
        v_x = torch.empty(ctx.shape)
        share = v_loss.item() / v_x.numel()
        v_ssim, v_absolute = -ctx.dssim_weight * share, (1 - ctx.dssim_weight) * share
        factors = np.float32(v_ssim), np.float32(v_absolute)
        v_rows = v_x.view(len(v_x), -1).numpy()
        backward(ctx.pair, ctx.v_maps, factors, v_rows, get_num_threads())
        return v_x, None, None

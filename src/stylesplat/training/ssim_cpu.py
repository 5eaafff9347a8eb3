"""SSIM on the CPU: value and gradient in two passes of separable filters.

Images are taken as [H, 3 W] rows, so that every inner loop runs over consecutive numbers. Borders
are zero-padded, like `ssim.ssim`, which this is tested against.
"""
# pyright: reportCallIssue=false, reportIncompatibleMethodOverride=false
# (it cannot count starred arguments, and torch's own signature of `backward` is (*args))

from typing import no_type_check

import numba
import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from stylesplat.training.ssim import C1, C2, WINDOW, ssim_window

CHANNELS = 3
HALF = WINDOW // 2
MARGIN = HALF * CHANNELS  # numbers of padding at both ends of a row


@no_type_check
@numba.njit(cache=True)
def blur_row(window, padded, out):
    """Filter a row along x; `padded` has `MARGIN` zeros at both ends."""
    n = out.shape[0]
    out[:] = 0
    for tap in range(WINDOW):
        shifted, weight = padded[tap * CHANNELS : tap * CHANNELS + n], window[tap]
        for j in range(n):
            out[j] += weight * shifted[j]


@no_type_check
@numba.njit(cache=True)
def blur_rows(window, image, row, padded):
    """Filter an image along y at one row, into the middle of `padded`."""
    n = image.shape[1]
    out = padded[MARGIN : MARGIN + n]
    out[:] = 0
    for tap in range(WINDOW):
        y = row + tap - HALF
        if 0 <= y < image.shape[0]:
            source, weight = image[y], window[tap]
            for j in range(n):
                out[j] += weight * source[j]


@no_type_check
@numba.njit(cache=True)
def product_rows(window, x, y, row, padded):
    """Filter x, y, x x, y y and x y along y at one row, into the middles of `padded`."""
    n = x.shape[1]
    padded[:, MARGIN : MARGIN + n] = 0
    mean_x, mean_y, xx, yy, xy = (
        padded[0, MARGIN:],
        padded[1, MARGIN:],
        padded[2, MARGIN:],
        padded[3, MARGIN:],
        padded[4, MARGIN:],
    )
    for tap in range(WINDOW):
        r = row + tap - HALF
        if 0 <= r < x.shape[0]:
            a, b, weight = x[r], y[r], window[tap]
            for j in range(n):
                u, v = a[j], b[j]
                mean_x[j] += weight * u
                mean_y[j] += weight * v
                xx[j] += weight * u * u
                yy[j] += weight * v * v
                xy[j] += weight * u * v


@no_type_check
@numba.njit(cache=True)
def similarities(blurred, v_mean, v_xx, v_xy):
    """The sum of a row's SSIM; its gradients by blurred x, x x and x y go to the last three."""
    total = 0.0
    c1, c2, two = np.float32(C1), np.float32(C2), np.float32(2)
    for j in range(v_mean.shape[0]):
        mx, my = blurred[0, j], blurred[1, j]
        var_x, var_y = blurred[2, j] - mx * mx, blurred[3, j] - my * my
        covar = blurred[4, j] - mx * my
        a, b = two * mx * my + c1, two * covar + c2
        c, d = mx * mx + my * my + c1, var_x + var_y + c2
        inverse = np.float32(1) / (c * d)
        value = a * b * inverse
        total += value
        v_xx[j] = -value / d
        v_xy[j] = two * a * inverse
        through_means = two * my * b * inverse - two * mx * value / c
        v_mean[j] = through_means - two * mx * v_xx[j] - my * v_xy[j]
    return total


@no_type_check
@numba.njit(cache=True, parallel=True)
def forward(window, x, y, v_maps, threads):
    """The mean SSIM of two images; fill the gradients by the three blurred maps [3, H, 3W]."""
    height, n = x.shape
    totals = np.zeros(threads)
    for thread in numba.prange(threads):
        padded = np.zeros((5, n + 2 * MARGIN), np.float32)
        blurred = np.empty((5, n), np.float32)
        for row in range(thread * height // threads, (thread + 1) * height // threads):
            product_rows(window, x, y, row, padded)
            for i in range(5):
                blur_row(window, padded[i], blurred[i])
            totals[thread] += similarities(blurred, v_maps[0, row], v_maps[1, row], v_maps[2, row])
    return totals.sum() / (height * n)


@no_type_check
@numba.njit(cache=True, parallel=True)
def backward(window, x, y, v_maps, scale, v_x, threads):
    """Fill the gradient of the first image, times `scale`: the filter is its own adjoint."""
    height, n = x.shape
    for thread in numba.prange(threads):
        padded = np.zeros(n + 2 * MARGIN, np.float32)
        blurred = np.empty((3, n), np.float32)
        for row in range(thread * height // threads, (thread + 1) * height // threads):
            for i in range(3):
                blur_rows(window, v_maps[i], row, padded)
                blur_row(window, padded, blurred[i])
            for j in range(n):
                squares = np.float32(2) * x[row, j] * blurred[1, j]
                v_x[row, j] = scale * (blurred[0, j] + squares + y[row, j] * blurred[2, j])


class _Ssim(Function):
    @staticmethod
    def forward(ctx, image, target):
        x, y = (t.detach().float().contiguous().view(len(t), -1) for t in (image, target))
        v_maps = x.new_empty(3, *x.shape)
        window = ssim_window().float().numpy()
        value = forward(window, x.numpy(), y.numpy(), v_maps.numpy(), get_num_threads())
        ctx.save_for_backward(x, y, v_maps)
        return x.new_tensor(value)

    @staticmethod
    @once_differentiable
    def backward(ctx, v_value):
        x, y, v_maps = ctx.saved_tensors
        v_x = torch.empty_like(x)
        scale = np.float32(v_value.item() / x.numel())
        arrays = (t.numpy() for t in (x, y, v_maps))
        backward(ssim_window().float().numpy(), *arrays, scale, v_x.numpy(), get_num_threads())
        return v_x.view(len(x), -1, CHANNELS), None


def ssim(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Mean structural similarity; gradients reach `image` only. See `ssim.ssim`."""
    return _Ssim.apply(image, target)

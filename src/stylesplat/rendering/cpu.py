"""Rendering on the CPU: numba kernels behind three differentiable functions.

Float32 by construction. Gradients reach means, quats, scales, opacities and colours; cameras are
taken as fixed.
"""
# pyright: reportCallIssue=false, reportIncompatibleMethodOverride=false
# (it cannot count starred arguments, and torch's own signature of `backward` is (*args))

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from stylesplat.rendering.kernels import (
    blend,
    blend_backward,
    project,
    project_backward,
    sh_colors,
    tiles,
)
from stylesplat.rendering.reference import Info
from stylesplat.rendering.sh import sh_bases

INFO = ("means2d", "conics", "depths", "radii")  # what `_Project` returns


def _plain(*tensors: Tensor) -> list[Tensor]:
    return [t.detach().contiguous() for t in tensors]


def _arrays(*tensors: Tensor) -> list:
    return [t.numpy() for t in tensors]


class _SphericalHarmonics(Function):
    @staticmethod
    def forward(ctx, bases, dirs, sh0, shN):
        inputs = _plain(dirs, sh0, shN)
        out = torch.empty_like(inputs[0])
        sh_colors.colors(bases, *_arrays(*inputs, out))
        ctx.bases = bases
        ctx.save_for_backward(*inputs, out)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, v_out):
        *inputs, out = ctx.saved_tensors
        gradients = [torch.empty_like(t) for t in inputs]
        arrays = _arrays(*inputs, out, *_plain(v_out), *gradients)
        sh_colors.colors_backward(ctx.bases, *arrays, get_num_threads())
        return None, *gradients


class _Project(Function):
    @staticmethod
    def forward(ctx, means, quats, scales, opacities, viewmat, K, width, height):
        *geometry, viewmat, K = _plain(means, quats, scales, opacities, viewmat, K)
        n = len(means)
        means2d, conics = means.new_empty(n, 2), means.new_empty(n, 3)
        depths, radii = means.new_empty(n, 1), torch.empty(n, 2, dtype=torch.int32)
        project.project(
            tuple(_arrays(*geometry)),
            *(*_arrays(viewmat, K), width, height),
            tuple(_arrays(means2d, conics, depths, radii)),
            get_num_threads(),
        )
        depths = depths[:, 0]
        ctx.size = width, height
        ctx.save_for_backward(*geometry[:3], viewmat, K, conics, radii)
        ctx.mark_non_differentiable(depths, radii)
        return means2d, conics, depths, radii

    @staticmethod
    @once_differentiable
    def backward(ctx, v_means2d, v_conics, v_depths, v_radii):
        *geometry, viewmat, K, conics, radii = ctx.saved_tensors
        gradients = [torch.empty_like(t) for t in geometry]
        project_backward.project_backward(
            tuple(_arrays(*geometry)),
            *(*_arrays(viewmat, K), *ctx.size, *_arrays(conics, radii)),
            tuple(_arrays(*_plain(v_means2d, v_conics))),
            tuple(_arrays(*gradients)),
            get_num_threads(),
        )
        return *gradients, None, None, None, None, None


class Drawing(NamedTuple):
    """Gaussians blended into one image, with what it takes to visit the same pixels again."""

    order: np.ndarray
    """The Gaussian of each rank, nearest first."""
    rows: Tensor
    """What blending reads, one row per rank; see `tiles.pack_rows`."""
    lists: tuple[np.ndarray, ...]
    """Ranks and masks by tile, without what other Gaussians hide; see `tiles.tile_lists`."""
    image: Tensor
    """Colours, [H, W, D]."""
    alphas: Tensor
    """Coverage, [H, W, 1]."""


def draw(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    colors: Tensor,
    depths: Tensor,
    radii: Tensor,
    size: tuple[int, int],
) -> Drawing:
    """Blend projected Gaussians, without gradients."""
    width, height = size
    inputs = _plain(means2d, conics, opacities, colors)
    channels = colors.shape[1]
    order = tiles.depth_order(*_arrays(depths, radii))
    rows = means2d.new_zeros(len(order), tiles.row_stride(channels))
    tiles.pack_rows(order, *_arrays(*inputs, rows))
    flat, stride = rows.view(-1).numpy(), rows.shape[1]
    lists = tiles.tile_lists(order, flat, stride, radii.numpy(), width, height, get_num_threads())
    image = means2d.new_empty(height, width, channels)
    alphas = means2d.new_empty(height, width, 1)
    blend.blend(
        *((0,) * channels, flat, stride, lists, width, height),
        *_arrays(image.view(-1), alphas.view(-1)),
        get_num_threads(),
    )
    return Drawing(order, rows, lists, image, alphas)


class _Blend(Function):
    @staticmethod
    def forward(ctx, means2d, conics, opacities, colors, depths, radii, size, geometry_channels):
        drawing = draw(means2d, conics, opacities, colors, depths, radii, size)
        order, rows, lists, image, alphas = drawing
        ctx.order, ctx.lists, ctx.geometry_channels = order, lists, geometry_channels
        ctx.save_for_backward(*_plain(means2d, conics, opacities, colors), rows, image, alphas)
        return image, alphas

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image, v_alphas):
        *inputs, rows, image, alphas = ctx.saved_tensors
        channels = image.shape[-1]
        head = min(channels, blend_backward.HEAD)
        stride = blend_backward.gradient_stride(channels)
        partial = rows.new_zeros(get_num_threads(), len(rows), stride)
        pixels = _plain(image, alphas, v_image, v_alphas)
        height, width, _ = image.shape
        blend_backward.blend_backward(
            *((0,) * n for n in (head, channels - head, ctx.geometry_channels)),
            *(rows.view(-1).numpy(), rows.shape[1], ctx.lists, width, height),
            tuple(t.view(-1).numpy() for t in pixels),
            partial.view(len(partial), -1).numpy(),
        )
        gradients = [torch.zeros_like(t) for t in inputs]
        blend_backward.collect_gradients(ctx.order, *_arrays(rows, partial, *gradients))
        return *gradients, None, None, None, None


def spherical_harmonics(
    degree: int,
    dirs: Float[Tensor, "N 3"],
    sh0: Float[Tensor, "N 1 3"],
    shN: Float[Tensor, "N _ 3"],
) -> Float[Tensor, "N 3"]:
    """Colours of Gaussians seen along `dirs`; see `sh.sh_colors`."""
    return _SphericalHarmonics.apply(sh_bases(degree), dirs, sh0, shN)


def project_gaussians(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    opacities: Float[Tensor, " N"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    size: tuple[int, int],
) -> tuple[Tensor, ...]:
    """`INFO` of activated Gaussians in one image of a width and height."""
    return _Project.apply(means, quats, scales, opacities, viewmat, K, *size)


def rasterize(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    opacities: Float[Tensor, " N"],
    colors: Float[Tensor, "C N D"],
    viewmats: Float[Tensor, "C 4 4"],
    Ks: Float[Tensor, "C 3 3"],
    width: int,
    height: int,
    geometry_channels: int,
) -> tuple[Float[Tensor, "C H W D"], Float[Tensor, "C H W 1"], Info]:
    """Render activated Gaussians; see `reference.rasterize`."""
    views = []
    for viewmat, K, camera_colors in zip(viewmats, Ks, colors, strict=True):
        projected = project_gaussians(means, quats, scales, opacities, viewmat, K, (width, height))
        means2d, conics, depths, radii = projected
        image, alpha = _Blend.apply(
            *(means2d, conics, opacities, camera_colors, depths, radii),
            *((width, height), geometry_channels),
        )
        views.append((image, alpha, *projected))
    render_colors, render_alphas, *projections = (
        _stacked(each) for each in zip(*views, strict=True)
    )
    return render_colors, render_alphas, dict(zip(INFO, projections, strict=True))


def _stacked(tensors: tuple[Tensor, ...]) -> Tensor:
    """The tensors along a new first axis; a single one is not copied."""
    return tensors[0][None] if len(tensors) == 1 else torch.stack(tensors)

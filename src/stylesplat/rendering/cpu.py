"""Rendering on the CPU: numba kernels behind differentiable functions.

Float32 by construction. Gradients reach means, quats, scales, opacities and colours, and the
cameras' poses where these ask for them; intrinsics are taken as fixed.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from numba import get_num_threads
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from stylesplat.rendering.kernels import blend, linear_blocks, project, sh_colors, tiles, vec
from stylesplat.rendering.kernels.blend import FlatImage
from stylesplat.rendering.kernels.front_depth import front_depths
from stylesplat.rendering.kernels.linear_blocks import BlockWeights
from stylesplat.rendering.kernels.sh_colors import Harmonics
from stylesplat.rendering.kernels.tiles import Ellipses, TileLists
from stylesplat.rendering.kernels.vec import LANES, FlatRows
from stylesplat.rendering.reference import (
    Gaussians,
    Projected,
    ProjectedView,
    Rasterizer,
    View,
)
from stylesplat.scene.splats import sh_bases

CHANNELS = 3, 6, 19  # colours; with some features; with identities: compiled for these alone
SUMMED = 4, 16  # and for the sums of weights times so many channels
PARTIAL_BYTES = 2**30  # a million Gaussians in view with 19 channels take 128 MB a thread

Struct = TypeVar("Struct", bound=tuple)


def arrays(noun: Struct) -> Struct:
    """The noun as kernels take it, without gradients: arrays that share the tensors' memory."""
    return type(noun)(*_as_arrays(*noun))


def _as_arrays(*fields: Any) -> list[Any]:
    return [f.detach().contiguous().numpy() if isinstance(f, Tensor) else f for f in fields]


def partial_sums(count: int, stride: int) -> Float[Tensor, "G count stride"]:
    """Zeros for what groups of tiles add up, each by itself: no two threads write to a row.

    There are as many groups as threads, and fewer where `PARTIAL_BYTES` would not hold them: then
    fewer threads work.
    """
    affordable = PARTIAL_BYTES // max(4 * count * stride, 1)
    return torch.zeros(max(1, min(get_num_threads(), affordable)), count, stride)


class _SphericalHarmonics(Function):
    @staticmethod
    def forward(ctx, bases, lowest, *harmonics):
        out = harmonics[0].new_empty(harmonics[0].shape)
        sh_colors.colors(bases, arrays(Harmonics(*harmonics)), lowest, out.numpy())
        ctx.bases, ctx.lowest = bases, lowest
        ctx.save_for_backward(out, *harmonics)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, v_out):
        out, *harmonics = ctx.saved_tensors
        gradients = Harmonics(*(t.new_empty(t.shape) for t in harmonics))
        sh_colors.colors_backward(
            ctx.bases,
            arrays(Harmonics(*harmonics)),
            ctx.lowest,
            *_as_arrays(out, v_out),
            arrays(gradients),
            get_num_threads(),
        )
        return None, None, *gradients


class _Project(Function):
    @staticmethod
    def forward(ctx, view, viewmat, *fields):
        gaussians = Gaussians(*fields)
        ctx.view, ctx.antialiased = view, gaussians.antialiased
        n, new = len(gaussians.means), gaussians.means.new_empty
        opacities = new(n if gaussians.antialiased else 0, 1)
        radii = torch.empty(n, 2, dtype=torch.int32)
        out = Projected(new(n, 2), new(n, 3), opacities, new(n, 1), radii)
        project.project_forward(arrays(gaussians), arrays(view), arrays(out), get_num_threads())
        out = out._replace(opacities=opacities[:, 0], depths=out.depths[:, 0])
        ctx.save_for_backward(viewmat, *gaussians[:4], *out)
        ctx.mark_non_differentiable(out.depths, out.radii)
        return tuple(out)

    @staticmethod
    @once_differentiable
    def backward(ctx, *v_projected):
        viewmat, means, quats, scales, opacities, *projected = ctx.saved_tensors
        gaussians, projected = (means, quats, scales), Projected(*projected)
        v_means, v_quats, v_scales = (t.new_empty(t.shape) for t in gaussians)
        v_opacities = means.new_empty(len(projected.opacities), 1)
        moves_view = ctx.needs_input_grad[1]
        sums = np.zeros((get_num_threads(), 12 if moves_view else 0, LANES))
        project.project_backward(
            arrays(Gaussians(*gaussians, opacities, ctx.antialiased)),
            arrays(ctx.view._replace(viewmat=viewmat)),
            arrays(projected),
            arrays(Projected(*v_projected)),
            arrays(Gaussians(v_means, v_quats, v_scales, v_opacities)),
            sums,
        )
        v_viewmat = None
        if moves_view:
            upper = torch.from_numpy(sums.sum(axis=(0, 2)).astype(np.float32)).view(3, 4)
            v_viewmat = torch.nn.functional.pad(upper, (0, 0, 0, 1))  # the last row is fixed
        v_opacities = v_opacities[:, 0] if ctx.antialiased else None
        return None, v_viewmat, v_means, v_quats, v_scales, v_opacities, None


class Tiled(NamedTuple):
    """Projected Gaussians, sorted into the tiles of one image."""

    order: np.ndarray
    """The Gaussian of each rank, nearest first."""
    rows: FlatRows
    """What blending reads, one row per rank; see `tiles.pack_rows`."""
    lists: TileLists
    """Ranks and masks by tile; blending strikes from them what other Gaussians hide."""


class Raster(NamedTuple):
    """Gaussians blended into one image, with what it takes to visit the same pixels again."""

    tiled: Tiled
    image: Tensor
    """Colours, [H, W, D]."""
    alphas: Tensor
    """Coverage, [H, W, 1]."""


def rasterize_to_pixels(projected: Projected, colors: Tensor, size: tuple[int, int]) -> Raster:
    """Blend projected Gaussians, without gradients, into an image of a width and height."""
    (width, height), channels = size, colors.shape[1]
    order, rows, radii = _pack(projected, colors)
    image = colors.new_empty(height, width, channels)
    alphas = colors.new_empty(height, width, 1)
    lists = _blend_groups(order, rows, radii, flat_image(image, alphas), channels)
    return Raster(Tiled(order, rows, lists), image, alphas)


def _pack(projected: Projected, colors: Tensor) -> tuple[np.ndarray, FlatRows, np.ndarray]:
    """What is visible of projected Gaussians, nearest first; their packed rows; all radii."""
    depths, radii = _as_arrays(projected.depths, projected.radii)
    order, stride = tiles.depth_order(depths, radii), tiles.row_stride(colors.shape[1])
    rows = FlatRows(colors.new_zeros(len(order) * stride).numpy(), stride)  # numpy aligns not
    tiles.pack_rows(order, arrays(Ellipses(*projected[:3], colors)), rows)
    return order, rows, radii


def _blend_groups(
    order: np.ndarray, rows: FlatRows, radii: np.ndarray, picture: FlatImage, channels: int
) -> TileLists:
    """Fill a picture from ranks, as many at a time as memory has room for; see `tiles`."""
    size, threads = (picture.width, picture.height), get_num_threads()
    groups = tiles.rank_groups(order, rows, radii, size)
    channel_vecs, parts, first = vec.channels(channels), list[TileLists](), 0
    blocks = tiles.tile_count(size) * blend.BLOCKS if len(groups) > 1 else 0
    states = np.zeros(blocks * blend.state_length(channel_vecs), np.float32)
    for totals in groups:
        some = slice(first, first + len(totals) - 1)
        some_rows = rows.part(some)
        lists = tiles.tile_lists(order[some], some_rows, radii, size, totals, threads)
        blend.blend_forward(channel_vecs, some_rows, lists, picture, states, not parts, threads)
        if len(groups) == 1:
            return lists
        parts.append(tiles.kept_entries(lists, first))
        if blend.is_finished(channel_vecs, states):
            break
        first = some.stop
    return tiles.joined_lists(parts)


def reaching(tiled: Tiled) -> Bool[np.ndarray, " R"]:
    """Which ranks reach a pixel, after blending."""
    _, ranks, masks = tiled.lists
    reaching = np.zeros(len(tiled.order), bool)
    reaching[ranks[masks != 0]] = True
    return reaching


def flat_image(image: Tensor, alphas: Tensor) -> FlatImage:
    """An image and its coverage, or their gradients, as kernels take them."""
    height, width, _ = image.shape
    colors, coverage = _as_arrays(image.flatten(), alphas.flatten())
    return FlatImage(colors, coverage, width, height)


class _Blend(Function):
    @staticmethod
    def forward(ctx, raster, geometry_channels, colors, *projected):
        ctx.tiled, image, alphas = raster
        ctx.geometry_channels, ctx.count = geometry_channels, len(colors)
        ctx.save_for_backward(image, alphas)
        return image, alphas

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image, v_alphas):
        image, alphas = ctx.saved_tensors
        (order, rows, lists), channels = ctx.tiled, image.shape[-1]
        partial = partial_sums(len(order), blend.gradient_stride(channels))
        blend.blend_backward(
            blend.split_channels(channels, ctx.geometry_channels),
            rows,
            lists,
            flat_image(image, alphas),
            flat_image(v_image, v_alphas),
            partial.flatten(1).numpy(),
        )
        shapes = (ctx.count, 2), (ctx.count, 3), (ctx.count,), (ctx.count, channels)
        v_ellipses = Ellipses(*(image.new_zeros(shape) for shape in shapes))
        blend.collect_gradients(order, rows, partial.numpy(), arrays(v_ellipses))
        *v_projected, v_colors = v_ellipses
        return None, None, v_colors, *v_projected, None, None


def padded(colors: Float[Tensor, "*B N _"]) -> Float[Tensor, "*B N D"]:
    """Colours with as many more channels, of zeros, as there are kernels for."""
    wanted = colors.shape[-1]
    unused = next((count for count in CHANNELS if count >= wanted), wanted) - wanted
    return torch.nn.functional.pad(colors, (0, unused)) if unused else colors


def store_contributions(
    tiled: Tiled, numbers: np.ndarray, size: tuple[int, int], max_bytes: float
) -> BlockWeights | None:
    """The weights of numbered ranks (-1 for others), unless they take more bytes."""
    starts, firsts = np.zeros((2, len(tiled.lists.starts)), np.int64)
    linear_blocks.count_pairs(tiled.lists, numbers, starts, firsts)
    if 2 * LANES * int(firsts[-1]) > max_bytes:  # float16
        return None
    gaussians, masks = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.uint16)
    weights = np.empty(firsts[-1] * LANES, np.uint16)
    blocks = BlockWeights(starts, firsts[:-1].copy(), gaussians, masks, weights)
    threads = get_num_threads()
    linear_blocks.store_weights(tiled.rows, tiled.lists, numbers, size, blocks, threads)
    return blocks


class _ComposeBlocks(Function):
    @staticmethod
    def forward(ctx, colors, blocks, background):
        height, width, _ = background.shape
        image = torch.empty_like(background)
        rows = torch.nn.functional.pad(colors.detach(), (0, 1))
        flat = (each.view(-1).numpy() for each in (rows, background, image))
        linear_blocks.render_linear(blocks, *flat, (width, height), get_num_threads())
        ctx.blocks, ctx.count = blocks, len(colors)
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image):
        return backproject_blocks(v_image, ctx.blocks, ctx.count), None, None


def compose_blocks(
    colors: Float[Tensor, "M 3"], blocks: BlockWeights, background: Float[Tensor, "H W 3"]
) -> Float[Tensor, "H W 3"]:
    """The background and what Gaussians of stored weights add; gradients reach the colours."""
    return _ComposeBlocks.apply(colors, blocks, background)


def backproject_blocks(
    image: Float[Tensor, "H W 3"], blocks: BlockWeights, count: int
) -> Float[Tensor, "M 3"]:
    """The sum over pixels of an image times the stored weights of each Gaussian."""
    height, width, _ = image.shape
    partial, flat = partial_sums(count, LANES), image.contiguous().view(-1).numpy()
    linear_blocks.compose_backward(blocks, flat, (width, height), partial.flatten(1).numpy())
    return partial.sum(dim=0)[:, :3]


class CpuRasterizer(Rasterizer):
    """By numba kernels."""

    def spherical_harmonics(
        self,
        degree: int,
        dirs: Float[Tensor, "N 3"],
        sh0: Float[Tensor, "N 1 3"],
        shN: Float[Tensor, "N _ 3"],
        *,
        clamp: bool = True,
    ) -> Float[Tensor, "N 3"]:
        lowest = sh_colors.ZERO if clamp else sh_colors.UNCLAMPED
        return _SphericalHarmonics.apply(sh_bases(degree), lowest, dirs, sh0, shN)

    def project_gaussians(self, gaussians: Gaussians, view: View) -> Projected:
        projected = Projected(*_Project.apply(view, view.viewmat, *gaussians))
        if gaussians.antialiased:
            return projected
        return projected._replace(opacities=gaussians.opacities)

    def blend(
        self,
        projected: Projected,
        colors: Float[Tensor, "N D"],
        size: tuple[int, int],
        *,
        geometry_channels: int,
    ) -> tuple[Float[Tensor, "H W D"], Float[Tensor, "H W 1"]]:
        wanted, colors = colors.shape[1], padded(colors)
        moving = colors.shape[1] if geometry_channels == wanted else geometry_channels
        raster = rasterize_to_pixels(projected, colors, size)
        image, alphas = _Blend.apply(raster, moving, colors, *projected)
        return image[..., :wanted], alphas

    def composite(
        self, tiled: ProjectedView, values: Float[Tensor, "N D"]
    ) -> Float[Tensor, "H W D"]:
        # By the kernels of colours: fewer are compiled
        return self.blend(tiled.projected, values, tiled.size, geometry_channels=3)[0]

    def backproject(
        self, tiled: ProjectedView, image: Float[Tensor, "H W D"]
    ) -> Float[Tensor, "N D"]:
        projected, size, wanted = tiled.projected, tiled.size, image.shape[-1]
        channels = next((count for count in SUMMED if count >= wanted), wanted)
        flat = torch.nn.functional.pad(image, (0, channels - wanted)).contiguous().view(-1).numpy()
        order, rows, radii = _pack(projected, image.new_empty(len(projected.depths), 0))
        light = np.empty(tiles.tile_count(size) * blend.BLOCKS * blend.PIXELS, np.float32)
        linear_blocks.open_light(light, size)
        by_rank, first = image.new_empty(len(order), wanted), 0
        for totals in tiles.rank_groups(order, rows, radii, size):
            some = slice(first, first + len(totals) - 1)
            part = rows.part(some)
            lists = tiles.tile_lists(order[some], part, radii, size, totals, get_num_threads())
            out = partial_sums(len(totals) - 1, LANES)
            linear_blocks.sum_weights(
                vec.channels(channels), part, lists, light, flat, size, out.flatten(1).numpy()
            )
            by_rank[some] = out.sum(dim=0)[:, :wanted]
            first = some.stop
        sums = image.new_zeros(len(projected.depths), wanted)
        return sums.index_copy_(0, torch.from_numpy(order).long(), by_rank)

    def front_depth(
        self,
        projected: Projected,
        planes: Float[Tensor, "N 3"],
        counted: Float[Tensor, " N"],
        size: tuple[int, int],
        shares: tuple[float, float],
    ) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
        tiled, image, _ = rasterize_to_pixels(projected, padded(counted[:, None]), size)
        depths, covered = image[..., 0].clone(), image[..., 0].contiguous()
        by_rank = torch.cat([planes, counted[:, None]], dim=1)[torch.from_numpy(tiled.order)]
        flat_planes, flat = (each.view(-1).numpy() for each in (by_rank, depths))
        both = np.asarray(shares, np.float32)
        front_depths(tiled.rows, flat_planes, tiled.lists, flat, size, both, get_num_threads())
        return depths, covered

"""Rendering on NVIDIA GPUs by our own kernels (`kernels/*.cu`), behind differentiable functions.

Float32 by construction. Gradients reach means, quats, scales, opacities and colours, and the
cameras' poses where these ask for them; intrinsics are taken as fixed.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from stylesplat.errors import StyleSplatError
from stylesplat.rendering import nvrtc
from stylesplat.rendering.nvrtc import FOLDER, THREADS, Argument
from stylesplat.rendering.reference import (
    Gaussians,
    Projected,
    Rasterizer,
    View,
)
from stylesplat.scene.splats import SH_C0, SH_C1, SH_C2, SH_C3, SH_C3_ZONAL, sh_bases

PROJECT, HARMONICS = FOLDER / "project.cu", FOLDER / "harmonics.cu"
TILES, BLEND = FOLDER / "tiles.cu", FOLDER / "blend.cu"
LARGE_TILE, SMALL_TILE = 16, 8  # pixels of a side
SMALL_IMAGE = 1024 * 1024  # pixels, up to which there are too few large tiles to fill a GPU
CHANNELS = 1, 4, 16, 20  # of a pass: coverage; colours; identities; both. Compiled for these alone
PLANES = 4  # channels of `front_depth`
ELLIPSE = 6  # gradient numbers of an ellipse
SH_CONSTANTS = {
    **{"SH_C0": SH_C0, "SH_C1": SH_C1},
    **dict(zip(("SH_A2", "SH_B2", "SH_C2"), SH_C2, strict=True)),
    **dict(zip(("SH_A3", "SH_B3", "SH_C3"), SH_C3, strict=True)),
    **dict(zip(("SH_ZONAL", "SH_TESSERAL"), SH_C3_ZONAL, strict=True)),
}


class TiledGaussians(NamedTuple):
    """Projected Gaussians, sorted into the tiles of one image."""

    means2d: Float[Tensor, "N 2"]
    conics: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    starts: Int[Tensor, " T"]
    """Cuts `order` into tiles."""
    order: Int[Tensor, " P"]
    """The Gaussians of each tile, front to back."""
    width: int
    height: int
    side: int
    """Of a tile, in pixels."""


def _float32(*tensors: Tensor) -> list[Tensor]:
    """Tensors as kernels read them."""
    for tensor in tensors:
        if tensor.dtype != torch.float32:
            raise StyleSplatError(
                f"GPUs render float32, and the splats are {tensor.dtype}. Convert them."
            )
    return [tensor.detach().contiguous() for tensor in tensors]


def _blend(
    name: str, tiled: TiledGaussians, part: slice, stride: int, *arguments: Argument
) -> None:
    """Run a kernel of `blend.cu` on some channels of rows that have `stride` of them."""
    *tensors, width, height, side = tiled
    count = part.stop - part.start
    compiled = next(channels for channels in CHANNELS if channels >= count)
    kernels = nvrtc.load_kernels(BLEND, tiled.means2d.device, TILE=side, CHANNELS=compiled)
    grid = -(-width // side), -(-height // side)
    given = *tensors, width, height, stride, part.start, count, *arguments
    kernels.launch(name, grid, side * side, *given)


def _parts(channels: int) -> list[slice]:
    """As many channels at a time as there are kernels for; of none one part, which is empty."""
    most = CHANNELS[-1]
    return [slice(k, min(k + most, channels)) for k in range(0, max(channels, 1), most)]


class _Project(Function):
    @staticmethod
    def forward(ctx, view, viewmat, *fields):
        gaussians = Gaussians(*fields)
        *tensors, antialiased = gaussians
        tensors = _float32(*tensors, viewmat, view.K)
        count, new = len(gaussians.means), gaussians.means.new_empty
        radii = torch.empty(count, 2, dtype=torch.int32, device=gaussians.means.device)
        opacities = new(count if antialiased else 0)
        out = Projected(new(count, 2), new(count, 3), opacities, new(count), radii)
        ctx.given = view.width, view.height, int(antialiased), count
        nvrtc.for_each_row(PROJECT, "project", radii.device, count, *tensors, *ctx.given, *out)
        ctx.save_for_backward(*tensors, radii)
        ctx.mark_non_differentiable(out.depths, radii)
        return tuple(out)

    @staticmethod
    @once_differentiable
    def backward(ctx, v_means2d, v_conics, v_opacities, *_):
        *tensors, radii = ctx.saved_tensors
        means, quats, scales, opacities, viewmat, _ = tensors
        *_, antialiased, count = ctx.given
        found = [each.new_empty(each.shape) for each in (means, quats, scales, opacities)]
        v_view = None
        if ctx.needs_input_grad[1]:
            v_view = torch.zeros(3, 4, dtype=torch.float64, device=means.device)
        incoming = [_with_rows(each) for each in (v_means2d, v_conics, v_opacities)]
        given = *tensors, *ctx.given, radii, *incoming, *(each.stride(0) for each in incoming)
        given = means.device, count, *given, *found, v_view
        nvrtc.for_each_row(PROJECT, "project_backward", *given)
        v_viewmat = None
        if v_view is not None:
            v_viewmat = torch.nn.functional.pad(v_view.to(viewmat), (0, 0, 0, 1))  # one is fixed
        *v_gaussians, v_opacities = found
        return None, v_viewmat, *v_gaussians, v_opacities if antialiased else None, None


def _with_rows(gradients: Tensor) -> Tensor:
    """Gradients whose rows may lie apart, but are rows."""
    return gradients if gradients.ndim == 1 or gradients.stride(1) == 1 else gradients.contiguous()


class _Blend(Function):
    @staticmethod
    def forward(ctx, tiled, moving, colors, *ellipses):
        (colors,), channels = _float32(colors), colors.shape[1]
        image = colors.new_empty(tiled.height, tiled.width, channels)
        alphas = colors.new_empty(tiled.height, tiled.width, 1)
        for part in _parts(channels):
            some = None if part.start else alphas
            _blend("blend", tiled, part, channels, colors, image, some)
        ctx.tiled, ctx.moving = tiled, moving
        ctx.save_for_backward(colors, image, alphas)
        return image, alphas

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image, v_alphas):
        colors, image, alphas = ctx.saved_tensors
        (count, channels), tiled = colors.shape, ctx.tiled
        v_image, v_alphas = v_image.contiguous(), v_alphas.contiguous()
        sums = image.new_zeros(count * (ELLIPSE + channels))
        v_ellipses, v_colors = sums.split([count * ELLIPSE, count * channels])
        for part in _parts(channels):
            moving = min(ctx.moving, part.stop) - part.start
            if part.start and moving <= 0:
                _blend("backproject", tiled, part, channels, v_image, v_colors)
                continue
            some = colors, image, alphas, v_image, None if part.start else v_alphas
            _blend("blend_backward", tiled, part, channels, moving, *some, v_colors, v_ellipses)
        v_means2d, v_conics, v_opacities = v_ellipses.view(count, ELLIPSE).split([2, 3, 1], dim=1)
        v_colors = v_colors.view(count, channels)
        return None, None, v_colors, v_means2d, v_conics, v_opacities[:, 0]


def _backproject(tiled: TiledGaussians, image: Float[Tensor, "H W D"]) -> Float[Tensor, "N D"]:
    (image,), channels = _float32(image), image.shape[-1]
    sums = image.new_zeros(len(tiled.opacities), channels)
    for part in _parts(channels):
        _blend("backproject", tiled, part, channels, image, sums)
    return sums


class _Composite(Function):
    @staticmethod
    def forward(ctx, tiled, values):
        ctx.tiled = tiled
        (values,), channels = _float32(values), values.shape[1]
        image = values.new_empty(tiled.height, tiled.width, channels)
        for part in _parts(channels):
            _blend("blend", tiled, part, channels, values, image, None)
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image):
        return None, _backproject(ctx.tiled, v_image)


class _SphericalHarmonics(Function):
    @staticmethod
    def forward(ctx, bases, lowest, *harmonics):
        dirs, sh0, shN = _float32(*harmonics)
        ctx.given = bases, shN.shape[1], lowest, len(dirs)
        out = torch.empty_like(dirs)
        _harmonics("colors", dirs, sh0, shN, *ctx.given, out)
        ctx.save_for_backward(dirs, sh0, shN, out)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, v_out):
        dirs, sh0, shN, out = ctx.saved_tensors
        v_dirs, v_sh0, v_shN = (each.new_empty(each.shape) for each in (dirs, sh0, shN))
        v_dirs = v_dirs if ctx.needs_input_grad[2] else None
        given = dirs, shN, out, v_out.contiguous(), *ctx.given
        _harmonics("colors_backward", *given, v_dirs, v_sh0, v_shN)
        return None, None, v_dirs, v_sh0, v_shN


def _harmonics(kernel: str, dirs: Tensor, *others: Argument) -> None:
    """Run a kernel with a thread for each direction."""
    given = dirs.device, len(dirs), dirs, *others
    nvrtc.for_each_row(HARMONICS, kernel, *given, **SH_CONSTANTS)


class CudaRasterizer(Rasterizer):
    """By our own kernels, which NVRTC compiles at first use."""

    def spherical_harmonics(
        self,
        degree: int,
        dirs: Float[Tensor, "N 3"],
        sh0: Float[Tensor, "N 1 3"],
        shN: Float[Tensor, "N _ 3"],
        *,
        clamp: bool = True,
    ) -> Float[Tensor, "N 3"]:
        lowest = 0.0 if clamp else -math.inf
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
        tiled = self.tile(projected, size)
        return _Blend.apply(tiled, geometry_channels, colors, *projected[:3])

    def tile(self, projected: Projected, size: tuple[int, int]) -> TiledGaussians:
        """Sort Gaussians into the tiles of an image; the host waits once, for a number."""
        (width, height), count = size, len(projected.depths)
        side = SMALL_TILE if width * height <= SMALL_IMAGE else LARGE_TILE
        columns, rows = -(-width // side), -(-height // side)
        means2d, conics, opacities, depths = _float32(*projected[:4])
        given = (
            means2d,
            conics,
            opacities,
            depths,
            projected.radii.contiguous(),
            columns,
            rows,
            count,
        )
        kernels, new = nvrtc.load_kernels(TILES, means2d.device, TILE=side), depths.new_empty
        counts = depths.new_zeros(columns * rows + 1, dtype=torch.int32)  # behind a 0
        grid = -(-count // THREADS), 1
        kernels.launch("list_tiles", grid, THREADS, *given, counts[1:], None, None)
        starts = counts.cumsum(dim=0)
        pairs = int(starts[-1])
        keys, order = new(pairs, dtype=torch.int64), new(pairs, dtype=torch.int32)
        kernels.launch("list_tiles", grid, THREADS, *given, counts[1:], starts, keys)
        kernels.launch("sort_tiles", (columns * rows, 1), THREADS, starts, keys, order)
        return TiledGaussians(means2d, conics, opacities, starts, order, width, height, side)

    def composite(
        self, tiled: TiledGaussians, values: Float[Tensor, "N D"]
    ) -> Float[Tensor, "H W D"]:
        return _Composite.apply(tiled, values)

    def backproject(
        self, tiled: TiledGaussians, image: Float[Tensor, "H W D"]
    ) -> Float[Tensor, "N D"]:
        return _backproject(tiled, image)

    @torch.no_grad()
    def front_depth(
        self,
        projected: Projected,
        planes: Float[Tensor, "N 3"],
        counted: Float[Tensor, " N"],
        size: tuple[int, int],
        shares: tuple[float, float],
    ) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
        tiled, rows = self.tile(projected, size), torch.cat([planes, counted[:, None]], dim=1)
        covered = self.composite(tiled, counted[:, None])[..., 0]
        depths, part = torch.empty_like(covered), slice(0, PLANES)
        _blend("front_depth", tiled, part, PLANES, rows, covered, *map(float, shares), depths)
        return depths, covered

"""Rendering on NVIDIA GPUs through gsplat 1.5.3 or 1.6, where it is installed.

The two differ in a few signatures, which are looked at, and in how opaque a Gaussian may get. Of no
Gaussians gsplat divides whole numbers by 0, which ends the process: it is not asked then.
"""

from functools import cache
from importlib import import_module
from inspect import signature
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering import reference
from stylesplat.rendering.reference import (
    EPS2D,
    FAR_PLANE,
    MAX_ALPHA,
    NEAR_PLANE,
    Gaussians,
    Projected,
    Projections,
    Rasterizer,
    View,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import pixel_centres

# 19 channels take 4.9 ms as 16 and 3, and 5.9 by gsplat's kernel for 32 (fox, 100,000 Gaussians,
# forward and backward, H200)
CHANNELS_AT_ONCE = 16
TILE = 16  # pixels of a tile's side, gsplat's default
EVERY_BATCH = 1 << 30  # as many batches of Gaussians as there are


def _no_kernels(error: Exception | None) -> StyleSplatError:
    """What to say where gsplat's kernels cannot be compiled; None if there is no toolkit."""
    fact = "gsplat finds no CUDA toolkit to compile its kernels with"
    if error is not None:  # torch's has the whole log of the compiler
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        first = next((line for line in lines if "error:" in line), lines[0] if lines else error)
        fact = f"Cannot compile gsplat's kernels: {first}"
    return StyleSplatError(
        f"{fact}. Install the toolkit of CUDA {torch.version.cuda} and a C++ compiler, or take the "
        "backend cuda, which needs neither."
    )


try:
    import gsplat
except Exception as error:  # 1.6 compiles its kernels when it is imported
    raise _no_kernels(error) from error


@cache
def require_kernels() -> None:
    """Load gsplat's kernels, which 1.5.3 compiles at first use. Raises a StyleSplatError."""
    try:
        kernels = import_module("gsplat.cuda._backend")._C
    except Exception as error:
        raise _no_kernels(error) from error
    if kernels is None:
        raise _no_kernels(None)


def _takes(function: Any, name: str) -> bool:
    return name in signature(function).parameters


def _largest_alpha() -> float:
    """How opaque a Gaussian is at most; version 1.5.3 has the number in its kernels alone."""
    try:
        return import_module("gsplat.cuda._constants").MAX_ALPHA
    except ImportError:
        return MAX_ALPHA


def _blended(colors: Float[Tensor, "C N D"], info: dict[str, Any]) -> Float[Tensor, "C H W D"]:
    """More channels of what gsplat has projected; their gradients reach the colours only."""
    image, _ = gsplat.rasterize_to_pixels(
        means2d=info["means2d"].detach(),
        conics=info["conics"].detach(),
        colors=colors,
        opacities=info["opacities"].detach(),
        image_width=info["width"],
        image_height=info["height"],
        tile_size=info["tile_size"],
        isect_offsets=info["isect_offsets"],
        flatten_ids=info["flatten_ids"],
    )
    return image


class GsplatRasterizer(Rasterizer):
    """By the installed gsplat."""

    def spherical_harmonics(
        self,
        degree: int,
        dirs: Float[Tensor, "N 3"],
        sh0: Float[Tensor, "N 1 3"],
        shN: Float[Tensor, "N _ 3"],
        *,
        clamp: bool = True,
    ) -> Float[Tensor, "N 3"]:
        sh = torch.cat([sh0, shN], dim=1)
        if _takes(gsplat.spherical_harmonics, "viewmats"):  # seen from the origin
            camera = torch.eye(4, dtype=dirs.dtype, device=dirs.device)[None]
            colors = gsplat.spherical_harmonics(degree, dirs, camera, sh)[0] + 0.5
        else:
            colors = gsplat.spherical_harmonics(degree, dirs, sh) + 0.5
        return colors.clamp(min=0) if clamp else colors

    @torch.no_grad()
    def project_gaussians(self, gaussians: Gaussians, view: View) -> Projected:
        means, quats, scales, opacities, antialiased = gaussians
        if not len(means):
            return super().project_gaussians(gaussians, view)
        radii, means2d, depths, conics, compensations = gsplat.fully_fused_projection(
            means,
            None,
            quats,
            scales,
            view.viewmat[None],
            view.K[None],
            view.width,
            view.height,
            eps2d=EPS2D,
            near_plane=NEAR_PLANE,
            far_plane=FAR_PLANE,
            calc_compensations=antialiased,
            opacities=opacities,
        )
        if antialiased:
            opacities = opacities * compensations[0]
        return Projected(means2d[0], conics[0], opacities, depths[0], radii[0])

    def rasterize(
        self,
        gaussians: Gaussians,
        colors: Float[Tensor, "C N D"],
        cameras: Cameras,
        *,
        geometry_channels: int,
    ) -> tuple[Float[Tensor, "C H W D"], Float[Tensor, "C H W 1"], Projections]:
        """Render; the Gaussians are projected and sorted into tiles once, for all channels."""
        if not len(gaussians.means):
            return super().rasterize(
                gaussians, colors, cameras, geometry_channels=geometry_channels
            )
        width, height = cameras.size
        moving, others = colors.tensor_split([geometry_channels], dim=-1)
        image, alphas, info = gsplat.rasterization(
            *gaussians[:4],
            colors=moving,
            viewmats=cameras.viewmats,
            Ks=cameras.Ks,
            width=width,
            height=height,
            near_plane=NEAR_PLANE,
            far_plane=FAR_PLANE,
            eps2d=EPS2D,
            packed=False,  # projections are [C, N, ...], as `Projections` are
            rasterize_mode="antialiased" if gaussians.antialiased else "classic",
            channel_chunk=CHANNELS_AT_ONCE,
        )
        if others.shape[-1] > 0:
            parts = [_blended(part, info) for part in others.split(CHANNELS_AT_ONCE, dim=-1)]
            image = torch.cat([image, *parts], dim=-1)
        return image, alphas, {key: info[key] for key in Projected._fields}

    def tile(self, projected: Projected, size: tuple[int, int]) -> dict[str, Any]:
        """Sort projected Gaussians into tiles, as gsplat's functions take them."""
        (width, height), count = size, len(projected.depths)
        info = {"width": width, "height": height, "tile_size": TILE, "count": count}
        if not count:
            return info
        columns, rows = -(-width // TILE), -(-height // TILE)
        places = projected.means2d[None], projected.radii[None], projected.depths[None]
        ellipses = {"conics": projected.conics[None], "opacities": projected.opacities[None]}
        has_exact_tiles = _takes(gsplat.isect_tiles, "conics")
        exact: dict[str, Any] = ellipses if has_exact_tiles else {}
        _, tiles, order = gsplat.isect_tiles(*places, TILE, columns, rows, **exact)
        return (
            info
            | ellipses
            | {
                "means2d": projected.means2d[None],
                "isect_offsets": gsplat.isect_offset_encode(tiles, 1, columns, rows),
                "flatten_ids": order,
            }
        )

    def composite(
        self, tiled: dict[str, Any], values: Float[Tensor, "N D"]
    ) -> Float[Tensor, "H W D"]:
        if not len(values):  # zeros, with a gradient
            return values.sum(dim=0).expand(tiled["height"], tiled["width"], -1)
        parts = [_blended(part[None], tiled)[0] for part in values.split(CHANNELS_AT_ONCE, dim=-1)]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=-1)

    def backproject(
        self, tiled: dict[str, Any], image: Float[Tensor, "H W D"]
    ) -> Float[Tensor, "N D"]:
        return reference.adjoint(self.composite, tiled, tiled["count"], image)

    @torch.no_grad()
    def front_depth(
        self,
        projected: Projected,
        planes: Float[Tensor, "N 3"],
        counted: Float[Tensor, " N"],
        size: tuple[int, int],
        shares: tuple[float, float],
    ) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
        """See `Rasterizer`; gsplat lists which Gaussians each pixel shows, front to back."""
        if not len(planes):
            return super().front_depth(projected, planes, counted, size, shares)
        (width, height), info = size, self.tile(projected, size)
        light = planes.new_ones(1, height, width)
        rows, pixels, _ = gsplat.rasterize_to_indices_in_range(
            0, EVERY_BATCH, light, info["means2d"], info["conics"], info["opacities"],
            width, height, TILE, info["isect_offsets"], info["flatten_ids"],
        )  # fmt: skip
        rows, pixels = rows.long(), pixels.long()
        centres = pixel_centres(width, height).to(planes)
        means2d, conics, opacities, *_ = projected
        offsets = centres[pixels] - means2d[rows]
        alphas = reference.alphas_at(offsets, conics[rows], opacities[rows], _largest_alpha())
        # The light that is left in front of each, from logarithms: pixels differ in length
        passing = torch.log1p(-alphas.double())
        before = passing.cumsum(dim=0) - passing
        starts = torch.searchsorted(pixels, torch.arange(len(centres)).to(pixels))
        before -= before[starts.clamp(max=max(len(pixels) - 1, 0))][pixels]
        weights = counted[rows] * alphas * before.exp().to(alphas)
        kept = weights.nonzero()[:, 0]
        pixels, rows, weights = pixels[kept], rows[kept], weights[kept]
        depths = reference.depths_at(projected, planes, rows, centres[pixels])
        image = reference.mean_depths(pixels, weights, depths, len(centres), shares)
        depths, covered = image.reshape(height, width, 2).unbind(dim=2)
        return depths, covered

"""Rendering on NVIDIA GPUs through gsplat 1.5.3, where it is installed.

Of no Gaussians gsplat divides whole numbers by 0, which ends the process: it is not asked then.
"""

from typing import Any

import gsplat
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.rendering import reference
from stylesplat.rendering.reference import (
    EPS2D,
    FAR_PLANE,
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
        _, tiles, order = gsplat.isect_tiles(*places, TILE, columns, rows)
        return info | {
            "means2d": projected.means2d[None],
            "conics": projected.conics[None],
            "opacities": projected.opacities[None],
            "isect_offsets": gsplat.isect_offset_encode(tiles, 1, columns, rows),
            "flatten_ids": order,
        }

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
        alphas = reference.alphas_at(offsets, conics[rows], opacities[rows])
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

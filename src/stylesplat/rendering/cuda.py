"""Rendering on NVIDIA GPUs, through gsplat 1.5.3."""
# pyright: reportCallIssue=false
# (it cannot count the arguments of starred lists)

import gsplat
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.rendering import constants as const
from stylesplat.rendering.reference import Info


def spherical_harmonics(
    degree: int,
    dirs: Float[Tensor, "N 3"],
    sh0: Float[Tensor, "N 1 3"],
    shN: Float[Tensor, "N _ 3"],
) -> Float[Tensor, "N 3"]:
    """Colours of Gaussians seen along `dirs`; see `sh.sh_colors`."""
    sh = torch.cat([sh0, shN], dim=1)
    return (gsplat.spherical_harmonics(degree, dirs, sh) + 0.5).clamp(min=0)


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
    options = {
        "near_plane": const.NEAR_PLANE,
        "far_plane": const.FAR_PLANE,
        "eps2d": const.EPS2D,
        "packed": False,
    }
    geometry = (means, quats, scales, opacities)
    camera = (viewmats, Ks, width, height)
    moving, other = colors.tensor_split([geometry_channels], dim=-1)
    image, alphas, info = gsplat.rasterization(*geometry, moving, *camera, **options)
    if other.shape[-1] > 0:
        frozen = (t.detach() for t in geometry)
        rest, _, _ = gsplat.rasterization(*frozen, other, *camera, **options)
        image = torch.cat([image, rest], dim=-1)
    return image, alphas, info

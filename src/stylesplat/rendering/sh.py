"""Spherical harmonics: view-dependent colour in plain torch."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.splats import SH_C0, sh_basis


def sh_bases(degree: int) -> int:
    """The number of basis functions up to a degree: 1, 4, 9 or 16."""
    return (degree + 1) ** 2


def sh_colors(
    degree: int,
    dirs: Float[Tensor, "N 3"],
    sh0: Float[Tensor, "N 1 3"],
    shN: Float[Tensor, "N _ 3"],
    *,
    clamp: bool = True,
) -> Float[Tensor, "N 3"]:
    """Colours of Gaussians seen along `dirs`.

    Args:
        degree: How many bands to use; `shN` may hold more.
        dirs: From the camera to the Gaussians, any norm.
        sh0: Constant band.
        shN: Higher bands.
        clamp: Whether colours below 0 become 0, as gsplat has it.
    """
    basis = sh_basis(degree, torch.nn.functional.normalize(dirs, dim=-1))
    sh = torch.cat([sh0, shN], dim=1)[:, : basis.shape[1]]
    colors = torch.einsum("nk,nkc->nc", basis, sh)
    return (colors + 0.5).clamp(min=0) if clamp else colors + 0.5


def sh0_from_rgb(rgb: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """The constant band that shows a colour in 0..1 from everywhere."""
    return (rgb - 0.5) / SH_C0


def rgb_from_sh0(sh0: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """The mean colour of a constant band, in 0..1 unless it is out of range."""
    return 0.5 + SH_C0 * sh0

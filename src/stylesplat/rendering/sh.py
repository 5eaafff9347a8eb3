"""Spherical harmonics: view-dependent colour in plain torch."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.splats import SH_C0

SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658)
SH_C3_ZONAL = (0.3731763325901154, 1.445305721320277)


def sh_bases(degree: int) -> int:
    """The number of basis functions up to a degree: 1, 4, 9 or 16."""
    return (degree + 1) ** 2


def sh_basis(degree: int, dirs: Float[Tensor, "N 3"]) -> Float[Tensor, "N K"]:
    """Real spherical harmonics in the order and with the signs of the INRIA code.

    Args:
        degree: 0 to 3.
        dirs: Unit vectors from the camera to the Gaussians.
    """
    x, y, z = dirs.unbind(-1)
    basis = [torch.full_like(x, SH_C0)]
    if degree >= 1:
        basis += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    if degree >= 2:
        a, b, c = SH_C2
        basis += [a * x * y, -a * y * z, b * (3 * z * z - 1), -a * x * z, c * (x * x - y * y)]
    if degree >= 3:
        a, b, c = SH_C3
        zonal, tesseral = SH_C3_ZONAL
        basis += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (5 * z * z - 1),
            zonal * z * (5 * z * z - 3),
            -c * x * (5 * z * z - 1),
            tesseral * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return torch.stack(basis, dim=-1)


def sh_colors(
    degree: int,
    dirs: Float[Tensor, "N 3"],
    sh0: Float[Tensor, "N 1 3"],
    shN: Float[Tensor, "N _ 3"],
) -> Float[Tensor, "N 3"]:
    """Colours of Gaussians seen along `dirs`, clamped at 0.

    Args:
        degree: How many bands to use; `shN` may hold more.
        dirs: From the camera to the Gaussians, any norm.
        sh0: Constant band.
        shN: Higher bands.
    """
    basis = sh_basis(degree, torch.nn.functional.normalize(dirs, dim=-1))
    sh = torch.cat([sh0, shN], dim=1)[:, : basis.shape[1]]
    colors = torch.einsum("nk,nkc->nc", basis, sh)
    return (colors + 0.5).clamp(min=0)


def sh0_from_rgb(rgb: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """The constant band that shows a colour in 0..1 from everywhere."""
    return (rgb - 0.5) / SH_C0


def rgb_from_sh0(sh0: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """The mean colour of a constant band, in 0..1 unless it is out of range."""
    return 0.5 + SH_C0 * sh0

"""The spherical harmonics that colours are made of."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.splats import SH_C0

SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658)
SH_C3_ZONAL = (0.3731763325901154, 1.445305721320277)


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

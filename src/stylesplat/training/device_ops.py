"""Operations of training that each device implements in its own way, as one interface."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

EPS = 1e-15  # of Adam, as in the 3D Gaussian splatting code
MAX_COPIES = 51  # of one Gaussian at a time (official)
DEAD_OPACITY = 0.005
NOISE_SHARPNESS = 100.0


class AdamTurn(NamedTuple):
    """What differs between one step of Adam and the next."""

    grad: Tensor
    visible: Bool[Tensor, " N"]
    """The rows to step; others stay as they are."""
    rate: float
    corrections: tuple[float, float]
    """Both moments are divided by these, because they started at 0."""


class Geometry(NamedTuple):
    """The tensors of Gaussians that noise depends on, as `Splats` stores them."""

    means: Float[Tensor, "N 3"]  # moved in place
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]


@runtime_checkable
class DeviceOps(Protocol):
    """The functions of a device's module."""

    def adam(
        self,
        param: Tensor,
        first: Tensor,
        second: Tensor,
        turns: Sequence[AdamTurn],
        kept: tuple[float, float],
    ) -> None:
        """Take Adam steps, one after the other, in place; `kept` are the decays of the moments."""
        ...

    def add_noise(self, geometry: Geometry, noise: Float[Tensor, "N 3"], rate: float) -> None:
        """Move means by a rate times their covariance times noise, faint Gaussians only."""
        ...

    def relocate(
        self,
        opacities: Float[Tensor, " M"],
        scales: Float[Tensor, "M 3"],
        copies: Int[Tensor, " M"],
    ) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"]]:
        """Activated opacities and scales with which so many copies look like one Gaussian.

        Equation 9 of 3DGS-MCMC (Kheradmand et al. 2024), for at most `MAX_COPIES`.
        """
        ...

    def nearest(
        self, means: Float[Tensor, "N 3"], sample: Int[Tensor, " S"], count: int
    ) -> Int[Tensor, "S k"]:
        """Rows of the nearest neighbours of some rows, without the rows themselves."""
        ...

    def photometric_loss(
        self, image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"], dssim_weight: float
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """L1 and D-SSIM, weighted; and the squared error of the clamped image, no gradient."""
        ...


def device_ops(device: torch.device) -> DeviceOps:
    """The implementation for a device."""
    if device.type == "cuda":
        from stylesplat.training import cuda_ops

        return cuda_ops
    from stylesplat.training import cpu_ops

    return cpu_ops

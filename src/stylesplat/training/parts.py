"""The trainer's work that each device does in its own way, as one interface."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

MAX_COPIES = 51  # of one Gaussian at a time (official)
DEAD_OPACITY = 0.005
NOISE_SHARPNESS = 100.0


class Turn(NamedTuple):
    """What differs between one step of Adam and the next."""

    grad: Tensor
    """The tensor's gradient."""
    rows: Bool[Tensor, " N"]
    """The rows to step; others stay as they are."""
    rate: float
    """Learning rate."""
    corrections: tuple[float, float]
    """What both means are divided by, for they started at 0."""


class AdamSteps(NamedTuple):
    """One tensor's steps of Adam; all tensors have as many rows as it."""

    param: Tensor
    """Changed in place."""
    first: Tensor
    """Running mean of the gradients, updated in place."""
    second: Tensor
    """Running mean of their squares, updated in place."""
    turns: Sequence[Turn]
    """One after the other."""
    kept: tuple[float, float]
    """The share of both means that stays."""


class Geometry(NamedTuple):
    """The tensors of Gaussians that noise depends on, as they are stored."""

    means: Float[Tensor, "N 3"]
    """Moved in place."""
    quats: Float[Tensor, "N 4"]
    """Of any norm."""
    scales: Float[Tensor, "N 3"]
    """Logarithms."""
    opacities: Float[Tensor, " N"]
    """Logits."""


@runtime_checkable
class Parts(Protocol):
    """What a module has to offer for a device."""

    def adam(self, steps: AdamSteps) -> None:
        """Adam (Kingma and Ba 2015), each time for some rows."""
        ...

    def drift(self, geometry: Geometry, noise: Float[Tensor, "N 3"], rate: float) -> None:
        """Move means by a rate times their covariance times noise, faint Gaussians only."""
        ...

    def relocated(
        self,
        opacities: Float[Tensor, " M"],
        scales: Float[Tensor, "M 3"],
        copies: Int[Tensor, " M"],
    ) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"]]:
        """Opacities and scales (not logarithms) with which so many copies look like one.

        Equation 9 of 3DGS-MCMC (Kheradmand et al. 2024), for at most `MAX_COPIES`.
        """
        ...

    def nearest(
        self, means: Float[Tensor, "N 3"], sample: Int[Tensor, " S"], count: int
    ) -> Int[Tensor, "S k"]:
        """Rows of the nearest others of some rows, themselves left out."""
        ...

    def photometric_loss(
        self, image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"], dssim_weight: float
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """L1 and D-SSIM, weighted; and the squared error of the clamped image, no gradient."""
        ...


def parts_for(device: torch.device) -> Parts:
    """The implementation for a device."""
    if device.type == "cuda":
        from stylesplat.training import cuda_parts

        return cuda_parts
    from stylesplat.training import cpu_parts

    return cpu_parts

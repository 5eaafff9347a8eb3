"""Rotations as files have them: as unit quaternions, or by the three smallest of their parts."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

LARGEST = 0.5**0.5  # that a part of a unit quaternion can be, if another one is larger
OTHERS = torch.tensor([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # but the largest of four


def unit_quats(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 4"]:
    """The same rotations of norm 1, also those whose squares float32 cannot hold."""
    return torch.nn.functional.normalize(quats.double(), dim=1).float()


def smallest_three(quats: Float[Tensor, "N 4"]) -> tuple[Int[Tensor, " N"], Float[Tensor, "N 3"]]:
    """Which part of each rotation is largest, and the others, between -`LARGEST` and `LARGEST`.

    The largest of four follows from the others.
    """
    quats = unit_quats(quats)
    largest = quats.abs().argmax(dim=1)
    quats = quats * quats.gather(1, largest[:, None]).sign()
    return largest, quats.gather(1, OTHERS[largest])


def whole_quats(largest: Int[Tensor, " N"], others: Float[Tensor, "N 3"]) -> Float[Tensor, "N 4"]:
    """The rotations again, wxyz, of length 1."""
    quats = torch.zeros(len(largest), 4).scatter(1, OTHERS[largest], others)
    missing = (1 - others.square().sum(dim=1)).clamp(min=0).sqrt()
    return quats.scatter(1, largest[:, None], missing[:, None])

"""Splats moved as one: turned with all that belongs to them, scaled alike, shifted."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.frames import Frame
from stylesplat.scene.sh_basis import sh_basis
from stylesplat.scene.splats import Splats

DIRECTIONS = 64  # 7 functions of the third degree are fixed by 7; more keep the system well-posed
GOLDEN = math.pi * (3 - math.sqrt(5))  # the angle between neighbours that spreads them evenly
EXACT = 1e-9  # float64 solves a half turn to 1e-15; what is within this of 0 or 1 is that


def moved(splats: Splats, frame: Frame) -> Splats:
    """The same splats in another world frame, with colours that turn along.

    A half turn about an axis changes nothing but signs and is exact, as is no turn at all.
    """
    rotation = frame.rotation.double()
    shN = splats.shN
    if not torch.equal(rotation, torch.eye(3).double()):
        shN = torch.einsum("lk,nkc->nlc", _band_turn(rotation, splats.sh_degree).to(shN), shN)
    quats = _product(_quaternion(rotation).to(splats.quats), splats.quats)
    return replace(
        splats,
        means=frame.place(splats.means),
        quats=quats,
        scales=splats.scales + math.log(frame.scale),
        shN=shN.contiguous(),
    )


def _band_turn(rotation: Float[Tensor, "3 3"], degree: int) -> Float[Tensor, "K K"]:
    """What turns the coefficients of the higher bands, all degrees after each other.

    A colour seen along `d` is afterwards what it was along the unturned `d`, for every `d`.
    """
    z = 1 - (torch.arange(DIRECTIONS).double() + 0.5) * (2 / DIRECTIONS)
    angle = GOLDEN * torch.arange(DIRECTIONS).double()
    across = (1 - z * z).sqrt()
    dirs = torch.stack([across * angle.cos(), across * angle.sin(), z], dim=1)
    after, before = sh_basis(degree, dirs), sh_basis(degree, dirs @ rotation)
    turn = torch.linalg.lstsq(after, before).solution
    whole = turn.round()
    return torch.where((turn - whole).abs() < EXACT, whole, turn)[1:, 1:]


def _quaternion(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "4"]:
    """Of a rotation, wxyz: from its largest part, so that no root is of nearly 0 (Shepperd)."""
    m = rotation.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    parts = [trace, m[0][0], m[1][1], m[2][2]]
    largest = parts.index(max(parts))
    if largest == 0:
        w = 1 + trace
        found = [w, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        found = [m[k][j] - m[j][k], 0.0, 0.0, 0.0]
        found[1 + i] = 1 + m[i][i] - m[j][j] - m[k][k]
        found[1 + j] = m[j][i] + m[i][j]
        found[1 + k] = m[k][i] + m[i][k]
    return torch.nn.functional.normalize(torch.tensor(found, dtype=torch.float64), dim=0)


def _product(one: Float[Tensor, "4"], other: Float[Tensor, "N 4"]) -> Float[Tensor, "N 4"]:
    """Hamilton's: the rotation of the other, then that of the one."""
    w, x, y, z = one.tolist()
    left = torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return other @ left.to(other).T

"""Worlds whose coordinates are too large for float32, such as UTM and ECEF in metres.

Their coordinates are read in 64 bits, and a whole number of units along each axis, the world's
offset, is subtracted before they become 32 bits. `Splats` and `Capture` keep the offset; numbers
that people type or read are in the world.
"""

import torch
from jaxtyping import Float, Float64
from torch import Tensor

Offset = tuple[float, float, float]

ORIGIN: Offset = (0.0, 0.0, 0.0)
LARGEST_POSITION = 1e9  # of a coordinate that is no mistake; the Earth's radius in metres is 6e6
# Times the extent, beyond which a coordinate is too large: of float32's 24 bits 16 are left for the
# extent, and 1 / 65536 of it is a thirtieth of a pixel in a picture of 2000
OFFSET_LARGEST_RATIO = 256
# Units, below which the offset, a whole number, would help little. Cameras of one standpoint and
# single Gaussians have no extent, and are no reason to move an ordinary scene
SMALLEST_EXTENT = 0.1
OFFSET_EDGE = 0.1  # share of the positions at each end of each axis that may be strays
OFFSET_SAMPLE = 100_000  # positions that are looked at


def choose_offset(positions: Float[Tensor, "M 3"]) -> Offset:
    """The offset that positions need to be precise in 32 bits; `ORIGIN` if they are without."""
    there = positions[(positions.abs() <= LARGEST_POSITION).all(dim=1)]
    if not len(there):
        return ORIGIN
    sample = there[:: max(1, len(there) // OFFSET_SAMPLE)].detach().cpu().double()
    shares = torch.tensor([OFFSET_EDGE, 0.5, 1 - OFFSET_EDGE], dtype=torch.float64)
    low, middle, high = sample.quantile(shares, dim=0)
    extent = max(float((high - low).max()), SMALLEST_EXTENT)
    if float(middle.abs().max()) <= OFFSET_LARGEST_RATIO * extent:
        return ORIGIN
    x, y, z = (middle.round() + 0.0).tolist()  # no -0
    return x, y, z


def to_world(points: Float[Tensor, "*B 3"], offset: Offset) -> Float64[Tensor, "*B 3"]:
    """Places in the world, which are given relative to its offset."""
    return points.double() + torch.tensor(offset, dtype=torch.float64, device=points.device)


def from_world(points: Float[Tensor, "*B 3"], offset: Offset) -> Float64[Tensor, "*B 3"]:
    """Places relative to the offset of the world, which are given in the world."""
    return points.double() - torch.tensor(offset, dtype=torch.float64, device=points.device)


def place_text(point: Float[Tensor, "3"], offset: Offset = ORIGIN) -> str:
    """A place in the world, given relative to the offset, for people: to about a thousandth."""
    if offset == ORIGIN:
        return ",".join(f"{value:.3g}" for value in point.tolist())
    return ",".join(f"{value:.3f}" for value in to_world(point, offset).tolist())


def announced(what: object, offset: Offset) -> str:
    """The line that says what is subtracted from the coordinates of a file."""
    return (
        f"{what} lies around {offset_text(offset)}, too far from the origin for float32: these are "
        "subtracted, and kept as its world_offset."
    )


def offset_text(offset: Offset) -> str:
    return " ".join(f"{value:.15g}" for value in offset)

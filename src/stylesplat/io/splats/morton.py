"""An order in which Gaussians that are close by follow each other."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

BITS = 21  # of each coordinate: three of them fill an integer of 64 bits, but for its sign
# By how many bits to part the halves, quarters and so on of a coordinate, and what is left then
SPREADS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_order(means: Float[Tensor, "N 3"]) -> Int[Tensor, " N"]:
    """The rows along a Z-order curve (Morton 1966), from the lowest corner to the highest."""
    if not len(means):
        return torch.zeros(0, dtype=torch.int64)
    points = means.double() - means.double().amin(dim=0)
    extent = points.max().clamp(min=torch.finfo(torch.float64).tiny)
    cells = (points / extent * (2**BITS - 1)).long()
    for shift, mask in SPREADS:
        cells = (cells | cells << shift) & mask
    return (cells << torch.arange(3)).sum(dim=1).argsort(stable=True)

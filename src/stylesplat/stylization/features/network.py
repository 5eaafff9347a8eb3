"""What stylisation asks of a feature network, whichever it is."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from llvmlite.binding import get_host_cpu_features
from torch import Tensor

from stylesplat.errors import StyleSplatError

FAST_BFLOAT16 = ("amx-bf16", "avx512bf16")
"""Instructions with which VGG's convolutions are faster in bfloat16 than in float32.

A convolution of 128 channels on 48x48 pixels took, in float32 and in bfloat16 (one thread):

    AVX2                5.6 ms   24.1 ms
    AVX-512             2.6 ms    8.2 ms
    AVX-512 with BF16   2.5 ms    1.3 ms

and AMX was five times as fast as float32.
"""


@dataclass(frozen=True)
class Convolution:
    """A convolution, its output as large as its input."""

    weight: Float[Tensor, "out in k k"]
    """Filters; the first layer's inputs are red, green, blue."""
    bias: Float[Tensor, " out"]
    """One number per filter."""

    def to(self, device: torch.device | str, dtype: torch.dtype) -> "Convolution":
        """The same convolution on another device and in another precision."""
        return Convolution(self.weight.to(device, dtype), self.bias.to(device, dtype))


@dataclass(frozen=True)
class Cells:
    """Where the features of a block lie in the image: cell `i` sees `[i * stride - before, +size)`.

    The receptive field is the same in x and y.
    """

    stride: int
    """Pixels from one feature to the next."""
    size: int
    """Pixels that a feature depends on at most, its receptive field."""
    before: int
    """How many of them lie before pixel `i * stride`."""

    def inside(self, length: int) -> slice:
        """The cells of an axis of `length` pixels whose receptive field is all in the image."""
        first = -(-self.before // self.stride)
        last = (length - self.size + self.before) // self.stride
        return slice(first, max(first, last + 1))


@runtime_checkable
class FeatureNetwork(Protocol):
    """Turns images into features, block by block, each at half the resolution of the last."""

    def __call__(
        self, image: Float[Tensor, "H W 3"], blocks: Sequence[int] = (3,)
    ) -> tuple[Float[Tensor, "_ _ _"], ...]:
        """The features of an image, its colours in 0..1.

        Args:
            image: May exceed 0..1, as renders do.
            blocks: Which blocks, counted from 1.

        Returns:
            For each block an image of features, in the network's precision.

        Raises:
            StyleSplatError: If the network has no such block.
        """
        ...

    def cells(self, block: int) -> Cells:
        """Where the features of a block, counted from 1, lie in the image."""
        ...

    @property
    def depth(self) -> int:
        """How many blocks it has."""
        ...

    @property
    def dtype(self) -> torch.dtype:
        """The precision of the convolutions."""
        ...

    def to(
        self, device: torch.device | str, dtype: torch.dtype = torch.float32
    ) -> "FeatureNetwork":
        """The same network on another device and in another precision."""
        ...


def check_blocks(blocks: Sequence[int], count: int) -> None:
    """Raise a StyleSplatError unless all blocks are among the first `count`."""
    if not blocks or min(blocks) < 1 or max(blocks) > count:
        raise StyleSplatError(
            f"Features of blocks {tuple(blocks)} were asked for, the network has blocks 1 to "
            f"{count}. Choose among those, or load deeper weights."
        )


@cache
def fastest_dtype(device: str) -> torch.dtype:
    """bfloat16 on processors that have instructions for it, else float32.

    It depends on the hardware alone, never on how busy that is.
    """
    if device != "cpu":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    features = get_host_cpu_features()
    fast = any(features.get(name, False) for name in FAST_BFLOAT16)
    return torch.bfloat16 if fast else torch.float32

"""VGG's convolutions, cut after the layers that style transfer needs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.network import Cells, Convolution, check_blocks

LAYERS_PER_BLOCK = 3  # ReLU outputs of a block that are concatenated (ARF); blocks 1, 2 have two
WIDTHS = (64, 128, 256, 512, 512)  # filters of a convolution, block by block
DEPTHS = {  # convolutions of a block (Simonyan & Zisserman 2014)
    "vgg16": (2, 2, 3, 3, 3),
    "vgg19": (2, 2, 4, 4, 4),
}


@dataclass(frozen=True)
class Vgg:
    """Blocks of convolutions with 2x2 maximum pooling between them."""

    blocks: tuple[tuple[Convolution, ...], ...]
    """Block 1 first; the last may be cut short."""
    mean: Float[Tensor, " 3"]
    """Colour in 0..1 that the first layer sees as zero."""
    std: Float[Tensor, " 3"]
    """Difference of colour that the first layer sees as one."""

    def __call__(
        self, image: Float[Tensor, "H W 3"], blocks: Sequence[int] = (3,)
    ) -> tuple[Float[Tensor, "_ _ _"], ...]:
        """The ReLU outputs of a block's first three layers, concatenated; see `FeatureNetwork`."""
        check_blocks(blocks, self.depth)
        x = ((image - self.mean) / self.std).permute(2, 0, 1)[None]  # channels-last in memory
        x = x.to(self.dtype)
        outputs = {}
        for number, block in enumerate(self.blocks[: max(blocks)], start=1):
            if number > 1:
                x = F.max_pool2d(x, 2)
            layers = []
            for conv in block:
                x = F.relu_(F.conv2d(x, conv.weight, conv.bias, padding=1))
                layers.append(x)
            outputs[number] = torch.cat(layers[:LAYERS_PER_BLOCK], dim=1)[0].permute(1, 2, 0)
        return tuple(outputs[number] for number in blocks)

    def cells(self, block: int) -> Cells:
        """Where the features of a block, counted from 1, lie in the image."""
        check_blocks([block], self.depth)
        size, before = 1, 0
        for number, convs in enumerate(self.blocks[:block], start=1):
            stride = 2 ** (number - 1)
            size += stride // 2  # the pooling before this block
            depth = len(convs) if number < block else len(convs[:LAYERS_PER_BLOCK])
            size, before = size + 2 * stride * depth, before + stride * depth
        return Cells(stride=2 ** (block - 1), size=size, before=before)

    @property
    def depth(self) -> int:
        """How many blocks it has."""
        return len(self.blocks)

    @property
    def dtype(self) -> torch.dtype:
        """The precision of the convolutions."""
        return self.blocks[0][0].weight.dtype

    def to(self, device: torch.device | str, dtype: torch.dtype = torch.float32) -> "Vgg":
        """The same network on another device and in another precision."""
        blocks = tuple(tuple(conv.to(device, dtype) for conv in block) for block in self.blocks)
        return replace(self, blocks=blocks, mean=self.mean.to(device), std=self.std.to(device))


def layer_widths(network: str, depth: int) -> tuple[tuple[int, ...], ...]:
    """The number of filters of each convolution down to the features of block `depth`.

    Raises:
        StyleSplatError: If the network is not that deep.
    """
    blocks = [(width,) * count for width, count in zip(WIDTHS, DEPTHS[network], strict=True)]
    if not 1 <= depth <= len(blocks):
        raise StyleSplatError(
            f"Block {depth} of {network} was asked for, it has blocks 1 to {len(blocks)}."
        )
    *whole, last = blocks[:depth]
    return (*whole, last[:LAYERS_PER_BLOCK])

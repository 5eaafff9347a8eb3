"""The network that ships with the package: a slim student of VGG19's first three blocks.

It works at half the picture's resolution from the start. Its features are VGG19's (the ReLU outputs
of a block, concatenated) in their principal directions: cosines and distances are the same there,
with a third of the numbers. How it was trained: `scripts/distill_features.py`; what it is good
for: `compact.md`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.network import Cells, Convolution, check_blocks

GREY, CONTRAST = 0.5, 4.0  # the colour that the first layer sees as zero, and its gain
FOLD = 2  # pixels along x and y that become channels of one
DEPTHS = (1, 2, 3)  # convolutions of a block; they see as far as VGG19's do
# A block-1 feature depends on the 6 pixels around its pair of pixels, the first or second of which
# it is: 2 before and 3 behind, or 3 before and 2 behind.
CELLS = (Cells(stride=1, size=7, before=3), Cells(2, 14, 6), Cells(4, 40, 18))


@dataclass(frozen=True)
class Compact:
    """Blocks of 3x3 convolutions, each with a linear head on the outputs of all its layers."""

    blocks: tuple[tuple[Convolution, ...], ...]
    """Three blocks; the first two work at half the resolution, the third at a quarter."""
    heads: tuple[Convolution, ...]
    """To the features; the first one's are those of 2x2 pixels."""

    def __call__(
        self, image: Float[Tensor, "H W 3"], blocks: Sequence[int] = (3,)
    ) -> tuple[Float[Tensor, "_ _ _"], ...]:
        """VGG19's features in their principal directions; see `FeatureNetwork`."""
        check_blocks(blocks, self.depth)
        height, width = image.shape[:2]
        x = (CONTRAST * (image - GREY)).permute(2, 0, 1)[None].to(self.dtype)
        x = F.pad(x, (0, width % FOLD, 0, height % FOLD))
        found = self.blocks_of(x, blocks)
        cut = []
        for number, feats in zip(blocks, found, strict=True):
            stride = CELLS[number - 1].stride
            cut.append(feats[0, :, : height // stride, : width // stride].permute(1, 2, 0))
        return tuple(cut)

    def blocks_of(self, x: Float[Tensor, "B 3 H W"], blocks: Sequence[int]) -> list[Tensor]:
        """The features [B,D,_,_] of pictures that are centred and padded already."""
        x = F.pixel_unshuffle(x, FOLD).contiguous(memory_format=torch.channels_last)
        outputs = {}
        for number, (block, head) in enumerate(zip(self.blocks, self.heads, strict=True), start=1):
            if number > max(blocks):
                break
            if number == 3:
                x = F.max_pool2d(x, 2)
            layers = []
            for conv in block:
                x = F.relu_(F.conv2d(x, conv.weight, conv.bias, padding=1))
                layers.append(x)
            if number in blocks:
                outputs[number] = F.conv2d(torch.cat(layers, dim=1), head.weight, head.bias)
        if 1 in outputs:
            outputs[1] = F.pixel_shuffle(outputs[1], FOLD)
        return [outputs[number] for number in blocks]

    def cells(self, block: int) -> Cells:
        """Where the features of a block, counted from 1, lie in the image."""
        check_blocks([block], self.depth)
        return CELLS[block - 1]

    @property
    def depth(self) -> int:
        """How many blocks it has."""
        return len(self.blocks)

    @property
    def dtype(self) -> torch.dtype:
        """The precision of the convolutions."""
        return self.heads[0].weight.dtype

    def to(self, device: torch.device | str, dtype: torch.dtype = torch.float32) -> "Compact":
        """The same network on another device and in another precision."""
        blocks = tuple(tuple(conv.to(device, dtype) for conv in block) for block in self.blocks)
        heads = tuple(head.to(device, dtype) for head in self.heads)
        return replace(self, blocks=blocks, heads=heads)


def compact_from(tensors: Mapping[str, Tensor], source: Path | str) -> Compact:
    """Assemble the network from tensors named `block1.conv1.weight`, `block1.head.bias` and so on.

    Args:
        tensors: With float16 or float32 numbers.
        source: Where they come from, for messages.

    Raises:
        StyleSplatError: If one is missing or does not fit the one before.
    """

    def convolution(name: str, inputs: int, side: int) -> Convolution:
        weight, bias = tensors.get(f"{name}.weight"), tensors.get(f"{name}.bias")
        fits = (
            weight is not None
            and bias is not None
            and weight.shape[:1] == bias.shape
            and weight.shape[1:] == (inputs, side, side)
        )
        if weight is None or bias is None or not fits:
            raise StyleSplatError(
                f"{source} holds no compact network: {name} is missing or does not fit. Leave out "
                "--weights, or choose the network of the file: --features vgg16 or vgg19."
            )
        weight = weight.float().contiguous(memory_format=torch.channels_last)
        return Convolution(weight, bias.float())

    blocks, heads, inputs = [], [], 3 * FOLD**2
    for number, depth in enumerate(DEPTHS, start=1):
        convs = []
        for layer in range(1, depth + 1):
            convs.append(convolution(f"block{number}.conv{layer}", inputs, 3))
            inputs = len(convs[-1].bias)
        blocks.append(tuple(convs))
        width = sum(len(conv.bias) for conv in convs)
        heads.append(convolution(f"block{number}.head", width, 1))
    return Compact(tuple(blocks), tuple(heads))

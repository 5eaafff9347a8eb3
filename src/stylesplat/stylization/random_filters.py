"""Seeded random filters of VGG's shape, for style transfer without any trained weights.

Dense random filters mix so many channels that all features look alike. These are sparse: each
filter is a random oriented wave, or a blur, over one channel (or one direction of colour), as in
a scattering network (Bruna & Mallat 2013). Rectified and pooled, they measure how much of each
orientation, scale and colour there is around a pixel, which is what tells brush strokes apart.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.stylization.features import Convolution, FeatureNetwork, layer_widths

COLORS = 3  # the first channels of every layer hand the blurred picture on
COLOR_GAIN = 4.0  # of those channels against the others' unit variance; chosen by eye
SHARES = (0.4, 0.4, 0.2)  # waves over the picture, blurs and waves over one channel; by eye
GREY_SHARE = 0.6  # of the filters over the picture see brightness only
FREQUENCIES = (0.2, 0.4)  # cycles per pixel that 3x3 filters can hold
WINDOW = 1.5  # twice the variance of the waves' Gaussian window, in square pixels
PICTURE_SIZE, DISCS = 160, 400  # of the picture whose statistics scale the layers


def random_network(depth: int, seed: int) -> FeatureNetwork:
    """A network of VGG16's shape down to block `depth`, with random filters.

    Args:
        depth: The deepest block whose features are needed.
        seed: The same seed gives the same network.
    """
    generator = torch.Generator().manual_seed(seed)
    mean, std = torch.zeros(COLORS), torch.full((COLORS,), 1 / COLOR_GAIN)
    x = ((dead_leaves(generator) - mean) / std).permute(2, 0, 1)[None]
    blocks = []
    for number, widths in enumerate(layer_widths("random", depth), start=1):
        x = F.max_pool2d(x, 2) if number > 1 else x
        block = []
        for width in widths:
            conv = _random_layer(x, width, generator)
            x = F.relu(F.conv2d(x, conv.weight, conv.bias, padding=1))
            block.append(conv)
        blocks.append(tuple(block))
    return FeatureNetwork(blocks=tuple(blocks), mean=mean, std=std)


def _random_layer(x: Tensor, width: int, generator: torch.Generator) -> Convolution:
    """A layer whose waves have mean 0 and variance 1 on `x`, so that about half of them fire."""
    inputs = x.shape[1]
    kinds = torch.multinomial(torch.tensor(SHARES), width, replacement=True, generator=generator)
    if inputs == COLORS:
        kinds[:] = 0  # the picture itself has nothing but colours
    kinds[:COLORS] = 1
    sources = torch.randint(min(COLORS, inputs - 1), inputs, (width,), generator=generator)
    sources[:COLORS] = torch.arange(COLORS)
    mix = F.one_hot(sources, inputs).float()
    colors = F.pad(_color_directions(width, generator), (0, inputs - COLORS))
    mix = torch.where((kinds == 0)[:, None], colors, mix)
    blurs = _blur().expand(width, 3, 3)
    kernels = torch.where((kinds == 1)[:, None, None], blurs, _waves(width, generator))
    weight = mix[:, :, None, None] * kernels[:, None]
    response = F.conv2d(x, weight, padding=1)
    mean, std = response.mean(dim=(0, 2, 3)), response.std(dim=(0, 2, 3))
    std[:COLORS] = 1
    bias = torch.where(kinds == 1, 0, -mean / std)
    return Convolution(weight / std[:, None, None, None], bias)


def _color_directions(count: int, generator: torch.Generator) -> Float[Tensor, "n 3"]:
    colors = torch.randn(count, COLORS, generator=generator)
    grey = torch.rand(count, generator=generator) < GREY_SHARE
    colors[grey] = colors[grey, :1].sign()
    return F.normalize(colors, dim=1)


def _waves(count: int, generator: torch.Generator) -> Float[Tensor, "n 3 3"]:
    """Gabor filters of random angle, phase and frequency, without response to flat areas."""
    angle, phase, pitch = torch.rand(3, count, 1, 1, generator=generator)
    low, high = FREQUENCIES
    ys, xs = torch.meshgrid(*[torch.arange(-1.0, 2.0)] * 2, indexing="ij")
    along = xs * (2 * math.pi * angle).cos() + ys * (2 * math.pi * angle).sin()
    window = torch.exp(-(xs**2 + ys**2) / WINDOW)
    waves = (2 * math.pi * (low + (high - low) * pitch) * along + math.pi * phase).cos() * window
    waves = waves - window * waves.sum(dim=(1, 2), keepdim=True) / window.sum()
    return F.normalize(waves.flatten(1), dim=1).reshape(-1, 3, 3)


def _blur() -> Float[Tensor, "3 3"]:
    binomial = torch.tensor([0.25, 0.5, 0.25])
    return binomial[:, None] * binomial


def dead_leaves(generator: torch.Generator) -> Float[Tensor, "H W 3"]:
    """A picture of overlapping coloured discs, whose edges and sizes are like those of photos."""
    ys, xs = torch.meshgrid(*[torch.arange(PICTURE_SIZE) / PICTURE_SIZE] * 2, indexing="ij")
    picture = torch.full((PICTURE_SIZE, PICTURE_SIZE, 3), 0.5)
    for x, y, size, *color in torch.rand(DISCS, 6, generator=generator).tolist():
        radius = 0.02 / (1 - 0.95 * size)  # their density falls with the square of the radius
        picture[(xs - x) ** 2 + (ys - y) ** 2 < radius**2] = torch.tensor(color)
    return picture

import pytest
import torch

from stylesplat.stylization.features.network import Convolution
from stylesplat.stylization.features.vgg import Vgg


@pytest.fixture(scope="session")
def network() -> Vgg:
    """Two blocks of few random filters; features of block 2 span 10 pixels."""
    generator = torch.Generator().manual_seed(0)
    blocks, inputs = [], 3
    for widths in ((8, 8), (12,)):
        convs = []
        for width in widths:
            weight = torch.randn(width, inputs, 3, 3, generator=generator) / (9 * inputs) ** 0.5
            convs.append(Convolution(weight, torch.zeros(width)))
            inputs = width
        blocks.append(tuple(convs))
    return Vgg(tuple(blocks), torch.full((3,), 0.5), torch.full((3,), 0.25))


@pytest.fixture(scope="session")
def stripes() -> torch.Tensor:
    """A style image of 48x40 pixels: slanted stripes of three colours."""
    ys, xs = torch.meshgrid(torch.arange(40), torch.arange(48), indexing="ij")
    colors = torch.tensor([[0.9, 0.8, 0.1], [0.1, 0.1, 0.6], [0.8, 0.2, 0.1]])
    return colors[(xs + 2 * ys) // 5 % 3]

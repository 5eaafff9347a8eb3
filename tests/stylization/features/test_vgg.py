import pytest
import torch
from torchvision.models import vgg

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.network import Convolution
from stylesplat.stylization.features.vgg import Vgg, layer_widths

OFFICIAL_LAYERS: dict[tuple[str, int], list[int]] = {  # of torchvision's `features`
    ("vgg16", 1): [1, 3],
    ("vgg16", 2): [6, 8],
    ("vgg16", 3): [11, 13, 15],
    ("vgg16", 4): [18, 20, 22],
    ("vgg19", 3): [11, 13, 15],
    ("vgg19", 4): [20, 22, 24],
}


def picture(height: int, width: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


def frozen(module: torch.nn.Conv2d) -> Convolution:
    assert module.bias is not None
    return Convolution(module.weight.detach(), module.bias.detach())


@pytest.mark.parametrize(("name", "block"), OFFICIAL_LAYERS)
def test_layers_are_those_of_torchvision(name: str, block: int):
    layers = OFFICIAL_LAYERS[name, block]
    with torch.random.fork_rng():
        torch.manual_seed(0)
        config = vgg.cfgs["D" if name == "vgg16" else "E"]
        modules = vgg.make_layers(config[: config.index(512) + 3 if block == 4 else 10])
    convs = iter(m for m in modules if isinstance(m, torch.nn.Conv2d))
    blocks = tuple(
        tuple(frozen(next(convs)) for _ in widths) for widths in layer_widths(name, block)
    )
    network = Vgg(blocks, torch.tensor([0.4, 0.5, 0.6]), torch.tensor([0.2, 0.3, 0.4]))
    image = picture(17, 26)

    x, outputs = ((image - network.mean) / network.std).permute(2, 0, 1)[None], []
    for index, module in enumerate(modules[: layers[-1] + 1]):
        x = module(x)
        if index in layers:
            outputs.append(x.detach().clone())
    expected = torch.cat(outputs, dim=1)[0].permute(1, 2, 0)
    torch.testing.assert_close(network(image, [block])[0], expected)


def test_the_default_features_are_the_papers():
    zeros = [[torch.zeros(w) for w in widths] for widths in layer_widths("vgg19", 3)]
    blocks = tuple(tuple(Convolution(torch.zeros(len(b), 1, 3, 3), b) for b in bs) for bs in zeros)
    cells = Vgg(blocks, torch.zeros(3), torch.ones(3)).cells(3)
    assert (cells.stride, cells.size) == (4, 40)
    assert sum(layer_widths("vgg19", 3)[-1]) == 768


@pytest.mark.parametrize("block", [1, 2])
def test_cells_say_what_a_feature_depends_on(network: Vgg, block: int):
    cells, at = network.cells(block), 9
    seen = torch.zeros(40, 40, dtype=torch.bool)
    for seed in range(30):  # pooling passes on one pixel of four: look at many pictures
        image = picture(40, 40, seed).requires_grad_()
        network(image, [block])[0][at, at].sum().backward()
        assert image.grad is not None
        seen |= (image.grad != 0).any(dim=-1)
    first = at * cells.stride - cells.before
    expected = torch.zeros_like(seen)
    expected[first : first + cells.size, first : first + cells.size] = True
    assert torch.equal(seen, expected)


@pytest.mark.parametrize("block", [1, 2])
def test_cells_inside_see_no_padding(network: Vgg, block: int):
    cells = network.cells(block)
    (feats,) = network(torch.full((31, 31, 3), 0.3), [block])
    inside = feats[cells.inside(31), cells.inside(31)].reshape(-1, feats.shape[-1])
    torch.testing.assert_close(inside, inside[:1].expand_as(inside))
    assert len(inside) > 0
    assert not torch.allclose(feats[0, 0], inside[0])  # while the border does


def test_no_cell_is_inside_a_picture_that_is_too_small(network: Vgg):
    cells = network.cells(2)
    counts = [len(range(100)[cells.inside(n)]) for n in range(cells.size - 1, cells.size + 2)]
    assert counts == [0, 1, 1]


def test_shifting_the_picture_shifts_the_features(network: Vgg):
    image = picture(40, 40)
    (feats,), (shifted,) = network(image, [2]), network(image[6:], [2])
    torch.testing.assert_close(feats[8:17, 5:15], shifted[5:14, 5:15])


def test_blocks_come_in_the_order_asked_for(network: Vgg):
    image = picture(20, 20)
    second, first = network(image, [2, 1])
    assert torch.equal(second, network(image, [2])[0])
    assert torch.equal(first, network(image, [1])[0])


@pytest.mark.parametrize("blocks", [[], [0], [1, 3]])
def test_missing_blocks(network: Vgg, blocks: list[int]):
    with pytest.raises(StyleSplatError, match=r"has blocks 1 to 2\. Choose"):
        network(picture(20, 20), blocks)


def test_vgg_has_five_blocks():
    with pytest.raises(StyleSplatError, match="Block 6 of vgg16"):
        layer_widths("vgg16", 6)

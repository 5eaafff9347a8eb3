from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features import (
    DEPTHS,
    PACKAGED,
    Convolution,
    FeatureNetwork,
    fastest_dtype,
    load_weights,
)

VGG19 = Path(__file__).parents[4] / "shared" / "weights" / "vgg19_conv1_1-conv3_4.safetensors"
CPUINFO = Path("/proc/cpuinfo")
OFFICIAL_LAYERS: dict[tuple[str, int], list[int]] = {  # of torchvision's `features`
    ("vgg16", 1): [1, 3],
    ("vgg16", 3): [11, 13, 15],
    ("vgg16", 4): [18, 20, 22],
    ("vgg19", 3): [11, 13, 15],
    ("vgg19", 4): [20, 22, 24],
}


def picture(height: int, width: int, seed: int = 0) -> torch.Tensor:
    """Coloured noise that has edges of several sizes."""
    generator = torch.Generator().manual_seed(seed)
    planes = torch.zeros(1, 3, height, width)
    for cells in (3, 9, 27):
        noise = torch.rand(1, 3, cells, cells, generator=generator)
        planes += F.interpolate(noise, (height, width), mode="bicubic") / 3
    return planes[0].permute(1, 2, 0).clamp(0, 1)


@pytest.fixture(scope="module")
def compact() -> FeatureNetwork:
    return load_weights("compact")


@pytest.fixture(params=["compact", "vgg"])
def either(
    request: pytest.FixtureRequest, compact: FeatureNetwork, network: FeatureNetwork
) -> FeatureNetwork:
    """The network of the package, and a VGG of few weights."""
    return compact if request.param == "compact" else network


@pytest.mark.parametrize(("name", "block"), OFFICIAL_LAYERS)
def test_layers_are_those_of_torchvision(name: str, block: int):
    from torchvision.models import vgg  # loads a compiler: seconds

    layers = OFFICIAL_LAYERS[name, block]
    with torch.random.fork_rng():
        torch.manual_seed(0)
        config = vgg.cfgs["D" if name == "vgg16" else "E"]
        modules = vgg.make_layers(config[: config.index(512) + 3 if block == 4 else 10])
    convs = (m for m in modules if isinstance(m, torch.nn.Conv2d))
    frozen = (Convolution(m.weight.detach(), m.bias.detach()) for m in convs if m.bias is not None)
    depths = [*DEPTHS[name][: block - 1], min(DEPTHS[name][block - 1], 3)]
    blocks = tuple(tuple(next(frozen) for _ in range(depth)) for depth in depths)
    network = FeatureNetwork(blocks, torch.tensor([0.4, 0.5, 0.6]), torch.tensor([0.2, 0.3, 0.4]))
    image = picture(17, 26)

    x, outputs = ((image - network.mean) / network.std).permute(2, 0, 1)[None], []
    for index, module in enumerate(modules[: layers[-1] + 1]):
        x = module(x)
        if index in layers:
            outputs.append(x.detach().clone())
    expected = torch.cat(outputs, dim=1)[0].permute(1, 2, 0)
    torch.testing.assert_close(network(image, [block])[0], expected)


@pytest.mark.parametrize("size", [(40, 48), (41, 47), (42, 45)])
def test_every_block_has_half_the_resolution_of_the_last(
    either: FeatureNetwork, size: tuple[int, int]
):
    blocks = range(1, either.depth + 1)
    shapes = [feats.shape[:2] for feats in either(picture(*size), blocks)]
    height, width = size
    assert shapes == [(height // 2**n, width // 2**n) for n in range(either.depth)]
    for missing in ([0], [1, 4]):
        with pytest.raises(StyleSplatError, match=r"has blocks 1 to \d\. Choose"):
            either(picture(20, 20), missing)


def test_blocks_come_in_the_order_asked_for_in_the_networks_precision(either: FeatureNetwork):
    image, order = picture(40, 40), [either.depth, *range(1, either.depth)]
    for number, feats in zip(order, either(image, order), strict=True):
        torch.testing.assert_close(either(image, [number])[0], feats)
    half = either.to("cpu", torch.bfloat16)
    assert half.dtype == half(image, [1])[0].dtype == torch.bfloat16


@pytest.mark.parametrize(("block", "at"), [(1, 20), (1, 21), (2, 11), (3, 6)])
def test_cells_say_what_a_feature_depends_on(either: FeatureNetwork, block: int, at: int):
    if block > either.depth:
        return
    cells = either.cells(block)
    seen = torch.zeros(60, 60, dtype=torch.bool)
    for seed in range(30):  # pooling passes on one pixel of four: look at many pictures
        generator = torch.Generator().manual_seed(seed)
        image = torch.rand(60, 60, 3, generator=generator).requires_grad_()
        either(image, [block])[0][at, at].sum().backward()
        assert image.grad is not None
        seen |= (image.grad != 0).any(dim=-1)
    first = at * cells.stride - cells.before
    inside = seen[first : first + cells.size, first : first + cells.size]
    assert inside.sum() == seen.sum(), "nothing outside"
    rows = inside.any(dim=1).nonzero()
    # in the compact network a feature of block 1 sees the same six pixels as the other of its pair
    side = 6 if block == 1 and cells.size == 7 else cells.size
    assert rows.max() - rows.min() + 1 == side


@pytest.mark.skipif(not VGG19.is_file(), reason="the developers' weights are not here")
def test_cosines_of_the_compact_network_are_those_of_vgg19(compact: FeatureNetwork):
    vgg19, image = load_weights("vgg19", VGG19), picture(128, 128)
    to_vgg19 = load_file(PACKAGED)
    for block in (1, 2, 3):
        margin = compact.cells(block).inside(128)
        (own,), (theirs,) = (net(image, [block]) for net in (compact, vgg19))
        turned = own @ to_vgg19[f"block{block}.to_vgg19"].float().T
        cosine = F.cosine_similarity(turned[margin, margin], theirs[margin, margin], dim=-1)
        assert cosine.mean() > 0.9  # a picture unlike those of the benchmark


@pytest.mark.skipif(not CPUINFO.is_file(), reason="only Linux lists what a processor can do there")
def test_the_fastest_precision_is_what_the_processor_can_do():
    flags = CPUINFO.read_text().split()
    fast = "amx_bf16" in flags or "avx512_bf16" in flags
    assert fastest_dtype("cpu") == (torch.bfloat16 if fast else torch.float32)

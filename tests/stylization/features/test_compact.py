from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.compact import Compact
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.weights import PACKAGED, load_vgg, load_weights

VGG19 = Path(__file__).parents[4] / "shared" / "weights" / "vgg19_conv1_1-conv3_4.safetensors"
BLOCKS = [1, 2, 3]


def picture(height: int, width: int, seed: int = 0) -> torch.Tensor:
    """Coloured noise, smooth enough to have edges of several sizes."""
    generator = torch.Generator().manual_seed(seed)
    planes = torch.zeros(1, 3, height, width)
    for cells in (3, 9, 27):
        noise = torch.rand(1, 3, cells, cells, generator=generator)
        planes += F.interpolate(noise, (height, width), mode="bicubic") / 3
    return planes[0].permute(1, 2, 0).clamp(0, 1)


@pytest.fixture(scope="module")
def compact() -> Compact:
    network = load_weights("compact")
    assert isinstance(network, Compact)
    return network


def test_it_ships_with_the_package_and_is_small():
    assert PACKAGED.stat().st_size < 3e6


def test_it_is_a_feature_network(compact: Compact):
    assert isinstance(compact, FeatureNetwork)
    assert compact.depth == 3
    half = compact.to("cpu", torch.bfloat16)
    assert half.dtype == torch.bfloat16
    assert half(picture(32, 32))[0].dtype == torch.bfloat16


@pytest.mark.parametrize("size", [(40, 48), (41, 47), (42, 45)])
def test_sizes_are_those_of_vgg(compact: Compact, size: tuple[int, int]):
    shapes = [feats.shape[:2] for feats in compact(picture(*size), BLOCKS)]
    height, width = size
    assert shapes == [(height, width), (height // 2, width // 2), (height // 4, width // 4)]


def test_blocks_alone_are_as_together(compact: Compact):
    image = picture(40, 40)
    for number, feats in zip([3, 1, 2], compact(image, [3, 1, 2]), strict=True):
        torch.testing.assert_close(compact(image, [number])[0], feats)


@pytest.mark.parametrize(("block", "at"), [(1, 20), (1, 21), (2, 11), (3, 6)])
def test_cells_say_what_a_feature_depends_on(compact: Compact, block: int, at: int):
    cells = compact.cells(block)
    seen = torch.zeros(60, 60, dtype=torch.bool)
    for seed in range(4):
        image = picture(60, 60, seed).requires_grad_()
        compact(image, [block])[0][at, at].sum().backward()
        assert image.grad is not None
        seen |= (image.grad != 0).any(dim=-1)
    first = at * cells.stride - cells.before
    inside = seen[first : first + cells.size, first : first + cells.size]
    assert inside.sum() == seen.sum(), "nothing outside"
    rows = inside.any(dim=1).nonzero()
    # a feature of block 1 sees the same six pixels as its neighbour in the pair
    assert rows.max() - rows.min() + 1 == (6 if block == 1 else cells.size)


@pytest.mark.parametrize("block", BLOCKS)
def test_cells_inside_see_no_padding(compact: Compact, block: int):
    cells = compact.cells(block)
    small, large = (compact(torch.full((n, n, 3), 0.3), [block])[0] for n in (61, 121))
    inside = small[cells.inside(61), cells.inside(61)]
    assert len(inside) > 0
    # block 1 holds the four pixels of a fold, which differ a little even on flat ground
    middle = 52 // cells.stride  # even, as the fold is
    expected = large[middle : middle + 2, middle : middle + 2]
    torch.testing.assert_close(inside[1:3, 1:3], expected, rtol=1e-3, atol=1e-3)
    border = small[0, 0] - expected[0, 0]
    assert border.norm() > 0.05 * expected[0, 0].norm()


def test_shifting_the_picture_shifts_the_features(compact: Compact):
    image = picture(80, 80)
    (feats,), (shifted,) = compact(image), compact(image[4:])
    torch.testing.assert_close(feats[6:14, 5:15], shifted[5:13, 5:15], rtol=1e-3, atol=1e-3)


@pytest.mark.skipif(not VGG19.is_file(), reason="the developers' weights are not here")
def test_cosines_are_those_of_vgg19(compact: Compact):
    vgg19, image = load_vgg("vgg19", VGG19), picture(128, 128)
    to_vgg19 = load_file(PACKAGED)
    for block in BLOCKS:
        margin = compact.cells(block).inside(128)
        (own,), (theirs,) = (net(image, [block]) for net in (compact, vgg19))
        turned = own @ to_vgg19[f"block{block}.to_vgg19"].float().T
        cosine = F.cosine_similarity(turned[margin, margin], theirs[margin, margin], dim=-1)
        assert cosine.mean() > 0.9  # a picture unlike those of the benchmark


def test_a_file_of_another_network(tmp_path: Path):
    path = tmp_path / "w.safetensors"
    save_file({"conv1_1.weight": torch.zeros(64, 3, 3, 3)}, path)
    with pytest.raises(StyleSplatError, match=r"no compact network: block1.conv1 is missing"):
        load_weights("compact", path)


def test_a_layer_that_does_not_fit(tmp_path: Path):
    tensors = load_file(PACKAGED) | {"block2.conv2.weight": torch.zeros(5, 5, 3, 3)}
    save_file(tensors, tmp_path / "w.safetensors")
    with pytest.raises(StyleSplatError, match=r"block2.conv2 is missing or does not fit"):
        load_weights("compact", tmp_path / "w.safetensors")


def test_it_has_three_blocks():
    with pytest.raises(StyleSplatError, match=r"Block 4 of compact .* Use --features vgg16"):
        load_weights("compact", depth=4)

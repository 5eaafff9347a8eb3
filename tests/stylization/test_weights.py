from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from scenes import rand
from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import Network
from stylesplat.stylization.features import PACKAGED, FeatureNetwork, load_weights

NAMES = {  # of the layers of block 1
    "torchvision": ["features.0", "features.2"],
    "original": ["conv1_1", "conv1_2"],
}


def block_1(naming: str) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    tensors = {}
    for name, inputs in zip(NAMES[naming], (3, 64), strict=True):
        tensors[f"{name}.weight"] = torch.randn(64, inputs, 3, 3, generator=generator)
        tensors[f"{name}.bias"] = torch.randn(64, generator=generator)
    return tensors


def same(one: FeatureNetwork, other: FeatureNetwork) -> bool:
    image = rand(8, 8, 3, seed=1)
    return torch.allclose(one(image, [1])[0], other(image, [1])[0], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("suffix", [".safetensors", ".pth", ".pt"])
def test_formats(tmp_path: Path, suffix: str):
    path, tensors = tmp_path / f"w{suffix}", block_1("torchvision")
    tensors["classifier.0.bias"] = torch.zeros(7)  # more than convolutions is no harm
    save_file(tensors, path) if suffix == ".safetensors" else torch.save(tensors, path)
    network = load_weights("vgg16", path, depth=1)
    assert torch.equal(network.blocks[0][1].weight, tensors["features.2.weight"])
    assert torch.equal(network.blocks[0][0].bias, tensors["features.0.bias"])
    torch.testing.assert_close(network.mean, torch.tensor([0.485, 0.456, 0.406]))
    torch.testing.assert_close(network.std, torch.tensor([0.229, 0.224, 0.225]))


def test_the_file_says_in_which_order_colours_are(tmp_path: Path):
    tensors = block_1("original")
    bgr, rgb, wrong = (tmp_path / f"{name}.safetensors" for name in ("bgr", "rgb", "wrong"))
    save_file(tensors, bgr)
    turned = tensors | {"conv1_1.weight": tensors["conv1_1.weight"].flip(1).contiguous()}
    metadata = {"input": "RGB 0..255 minus mean (123.68, 116.779, 103.939)"}
    save_file(turned, rgb, metadata=metadata)
    save_file(tensors, wrong, metadata=metadata)
    original = load_weights("vgg19", bgr, depth=1)
    assert same(original, load_weights("vgg19", rgb, depth=1))
    assert not same(original, load_weights("vgg19", wrong, depth=1))


def test_original_weights_see_blue_first(tmp_path: Path):
    tensors = {name: torch.zeros_like(t) for name, t in block_1("original").items()}
    tensors["conv1_1.weight"][0, 0, 1, 1] = 1
    save_file(tensors, tmp_path / "w.safetensors")
    network = load_weights("vgg19", tmp_path / "w.safetensors", depth=1)
    assert network.blocks[0][0].weight[0, :, 1, 1].tolist() == [0, 0, 1]
    image = torch.zeros(4, 4, 3)
    image[..., 2] = 1.0  # blue
    feats = network(image, [1])[0]
    torch.testing.assert_close(feats[2, 2, 0], torch.tensor(255 - 103.939))


NO_BLOCK_2 = r"(features.5|conv2_1) is missing or its filters do not have the shape \[64, 3, 3\]"
TORCHVISION, ORIGINAL, PACKED = block_1("torchvision"), block_1("original"), load_file(PACKAGED)
SMALL = torch.zeros(32, 64, 3, 3)


@pytest.mark.parametrize(
    ("tensors", "network", "depth", "fault"),
    [
        (TORCHVISION | {"features.16.weight": SMALL}, "vgg16", 1, "holds vgg19, not vgg16. Use"),
        (TORCHVISION | {"features.17.weight": SMALL}, "vgg19", 1, "holds vgg16, not vgg19. Use"),
        (TORCHVISION | {"features.2.weight": SMALL}, "vgg16", 1, r"features.2 .* \[64, 3, 3\]"),
        (TORCHVISION | {"features.0.bias": torch.full((64,), torch.inf)}, "vgg16", 1, "not finite"),
        (TORCHVISION, "vgg16", 2, NO_BLOCK_2),
        (ORIGINAL, "vgg16", 2, NO_BLOCK_2),
        (ORIGINAL, "compact", 3, "block1.conv1 is missing"),
        (PACKED | {"block2.conv2.weight": SMALL}, "compact", 3, "block2.conv2 is missing or its"),
    ],
)
def test_files_that_do_not_fit(
    tmp_path: Path, tensors: dict[str, torch.Tensor], network: Network, depth: int, fault: str
):
    save_file(tensors, tmp_path / "w.safetensors")
    with pytest.raises(StyleSplatError, match=fault):
        load_weights(network, tmp_path / "w.safetensors", depth=depth)


@pytest.mark.parametrize("suffix", [".safetensors", ".pth"])
def test_unreadable(tmp_path: Path, suffix: str):
    path = tmp_path / f"w{suffix}"
    with pytest.raises(StyleSplatError, match="There is no weights file"):
        load_weights("vgg16", path)
    path.write_bytes(b"no weights at all")
    with pytest.raises(StyleSplatError, match="Cannot read the weights file"):
        load_weights("vgg16", path)
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(StyleSplatError, match="Cannot read the weights file"):
        load_weights("vgg16", tmp_path / "list.pth")


def test_torchvisions_cache_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(StyleSplatError, match="no file of vgg16's weights"):
        load_weights("vgg16", depth=1, download=False)
    (tmp_path / "hub" / "checkpoints").mkdir(parents=True)
    torch.save(TORCHVISION, tmp_path / "hub" / "checkpoints" / "vgg16-397923af.pth")
    network = load_weights("vgg16", depth=1)
    assert torch.equal(network.blocks[0][0].weight, TORCHVISION["features.0.weight"])

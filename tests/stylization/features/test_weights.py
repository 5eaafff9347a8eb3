from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.vgg import layer_widths
from stylesplat.stylization.features.weights import cache_folder, load_vgg
from stylesplat.stylization.matching import nnfm_loss

SHARED = Path(__file__).parents[4] / "shared" / "weights" / "vgg19_conv1_1-conv3_4.safetensors"
NAMES = {  # of the layers of block 1, and of the first of blocks 2 and 3
    "torchvision": ["features.0", "features.2", "features.5"],
    "original": ["conv1_1", "conv1_2", "conv2_1"],
}


def block_1(naming: str) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    tensors = {}
    for name, inputs in zip(NAMES[naming], (3, 64), strict=False):
        tensors[f"{name}.weight"] = torch.randn(64, inputs, 3, 3, generator=generator)
        tensors[f"{name}.bias"] = torch.randn(64, generator=generator)
    return tensors


def same(one: FeatureNetwork, other: FeatureNetwork) -> bool:
    image = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(1))
    return torch.allclose(one(image, [1])[0], other(image, [1])[0], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("suffix", [".safetensors", ".pth", ".pt"])
def test_formats(tmp_path: Path, suffix: str):
    path, tensors = tmp_path / f"w{suffix}", block_1("torchvision")
    tensors["classifier.0.bias"] = torch.zeros(7)  # more than convolutions is no harm
    save_file(tensors, path) if suffix == ".safetensors" else torch.save(tensors, path)
    network = load_vgg("vgg16", path, depth=1)
    assert torch.equal(network.blocks[0][1].weight, tensors["features.2.weight"])
    assert torch.equal(network.blocks[0][0].bias, tensors["features.0.bias"])


def test_preprocessing_makes_equal_networks_of_equal_weights(tmp_path: Path):
    """The same function of the picture, written down in three ways."""
    tensors = block_1("original")
    bgr, rgb = tmp_path / "bgr.safetensors", tmp_path / "rgb.safetensors"
    save_file(tensors, bgr)
    turned = tensors | {"conv1_1.weight": tensors["conv1_1.weight"].flip(1).contiguous()}
    save_file(turned, rgb, metadata={"input": "RGB 0..255 minus mean (123.68, 116.779, 103.939)"})
    original = load_vgg("vgg19", bgr, depth=1)
    assert same(original, load_vgg("vgg19", rgb, depth=1))
    assert same(original, load_vgg("vgg19", bgr, depth=1, preprocessing="caffe-bgr"))
    assert not same(original, load_vgg("vgg19", bgr, depth=1, preprocessing="caffe-rgb"))
    assert not same(original, load_vgg("vgg19", bgr, depth=1, preprocessing="torchvision"))


def test_original_weights_see_blue_first(tmp_path: Path):
    tensors = {name: torch.zeros_like(t) for name, t in block_1("original").items()}
    tensors["conv1_1.weight"][0, 0, 1, 1] = 1
    save_file(tensors, tmp_path / "w.safetensors")
    network = load_vgg("vgg19", tmp_path / "w.safetensors", depth=1)
    assert network.blocks[0][0].weight[0, :, 1, 1].tolist() == [0, 0, 1]
    image = torch.zeros(4, 4, 3)
    image[..., 2] = 1.0  # blue
    feats = network(image, [1])[0]
    torch.testing.assert_close(feats[2, 2, 0], torch.tensor(255 - 103.939))


def test_torchvision_preprocessing(tmp_path: Path):
    save_file(block_1("torchvision"), tmp_path / "w.safetensors")
    network = load_vgg("vgg16", tmp_path / "w.safetensors", depth=1)
    torch.testing.assert_close(network.mean, torch.tensor([0.485, 0.456, 0.406]))
    torch.testing.assert_close(network.std, torch.tensor([0.229, 0.224, 0.225]))


def test_wrong_network(tmp_path: Path):
    path = tmp_path / "w.safetensors"
    save_file(block_1("torchvision") | {"features.16.weight": torch.zeros(1)}, path)
    with pytest.raises(StyleSplatError, match=r"holds vgg19, not vgg16\. Use --features vgg19"):
        load_vgg("vgg16", path, depth=1)
    save_file(block_1("torchvision") | {"features.17.weight": torch.zeros(1)}, path)
    with pytest.raises(StyleSplatError, match=r"holds vgg16, not vgg19\. Use --features vgg16"):
        load_vgg("vgg19", path, depth=1)


def test_wrong_shape(tmp_path: Path):
    tensors = block_1("torchvision") | {"features.2.weight": torch.zeros(32, 64, 3, 3)}
    save_file(tensors, tmp_path / "w.safetensors")
    with pytest.raises(
        StyleSplatError, match=r"features.2.weight should have the shape \[64, 64, 3, 3\]"
    ):
        load_vgg("vgg16", tmp_path / "w.safetensors", depth=1)


@pytest.mark.parametrize("naming", ["torchvision", "original"])
def test_layer_missing(tmp_path: Path, naming: str):
    save_file(block_1(naming), tmp_path / "w.safetensors")
    with pytest.raises(
        StyleSplatError,
        match=r"lacks features.5.weight \(or conv2_1.weight\) of the shape \[128, 64, 3, 3\]",
    ):
        load_vgg("vgg16", tmp_path / "w.safetensors", depth=2)


@pytest.mark.parametrize("suffix", [".safetensors", ".pth"])
def test_unreadable(tmp_path: Path, suffix: str):
    path = tmp_path / f"w{suffix}"
    path.write_bytes(b"no weights at all")
    with pytest.raises(StyleSplatError, match="Cannot read the weights file"):
        load_vgg("vgg16", path)
    with pytest.raises(StyleSplatError, match="There is no weights file"):
        load_vgg("vgg16", tmp_path / f"none{suffix}")


def test_a_file_of_something_else(tmp_path: Path):
    torch.save([1, 2], tmp_path / "w.pth")
    with pytest.raises(StyleSplatError, match="Cannot read the weights file"):
        load_vgg("vgg16", tmp_path / "w.pth")


def test_torchvisions_cache_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "hub" / "checkpoints").mkdir(parents=True)
    tensors = block_1("torchvision")
    torch.save(tensors, tmp_path / "hub" / "checkpoints" / "vgg16-397923af.pth")
    network = load_vgg("vgg16", depth=1)
    assert torch.equal(network.blocks[0][0].weight, tensors["features.0.weight"])


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch):
    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", home)
    with pytest.raises(StyleSplatError, match=r"no home folder .* Set XDG_CACHE_HOME"):
        cache_folder()


@pytest.mark.skipif(not SHARED.is_file(), reason="the developers' weights are not here")
def test_real_weights():
    network = load_vgg("vgg19", SHARED)
    widths = tuple(tuple(len(conv.bias) for conv in block) for block in network.blocks)
    assert widths == layer_widths("vgg19", 3)
    torch.testing.assert_close(network.mean * 255, torch.tensor([123.68, 116.779, 103.939]))
    # Trained filters keep the scale of the signal; with inputs 255 times too small they would not.
    image = torch.rand(48, 48, 3, generator=torch.Generator().manual_seed(0))
    feats = network(image)[0].reshape(-1, 768)
    assert 10 < feats.mean() < 1000
    assert nnfm_loss(feats, feats) < 1e-5

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.style_image import resize, style_features


def test_shape_is_kept(stripes: torch.Tensor):
    assert resize(stripes, 24.0).shape == (20, 24, 3)
    assert resize(stripes.transpose(0, 1), 96.0).shape == (96, 80, 3)


def test_resizing_averages():
    noise = torch.rand(256, 256, 3, generator=torch.Generator().manual_seed(0))
    assert resize(noise, 8.0).std() < 0.1 * noise.std()
    torch.testing.assert_close(resize(noise, 8.0).mean(), noise.mean(), atol=0.01, rtol=0)


def test_features_of_a_flat_style_are_all_the_same(network: FeatureNetwork):
    """Those of the border, which see the padding, would differ."""
    for feats in style_features(torch.full((30, 40, 3), 0.7), network, [1, 2], length=40.0):
        assert len(feats) > 50
        torch.testing.assert_close(feats, feats[:1].expand_as(feats))


def test_small_pictures(network: FeatureNetwork):
    with pytest.raises(StyleSplatError, match=r"it is 30x10 pixels.* Choose a larger"):
        style_features(torch.rand(10, 30, 3), network, [2], length=100.0)
    with pytest.raises(StyleSplatError, match=r"it becomes 10x10 pixels.* Raise the style scale"):
        style_features(torch.rand(50, 50, 3), network, [2], length=10.0)
    assert len(style_features(torch.rand(11, 11, 3), network, [2], length=11.0)[0]) >= 1


def test_huge_pictures_are_shrunk(network: FeatureNetwork):
    (feats,) = style_features(torch.rand(600, 500, 3), network, [2], length=40.0)
    assert len(feats) < 20 * 20

import pytest
import torch

from stylesplat.evaluation.own_distance import own_nnfm, share_of_way
from stylesplat.stylization.features.vgg import Vgg
from stylesplat.stylization.matching import nnfm_loss
from stylesplat.stylization.target import style_features


def test_a_pattern_that_repeats_is_everywhere_as_near_by(network: Vgg):
    tile = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0))
    repeated = tile.repeat(6, 6, 1)  # 48 pixels: features of block 2 span 10
    assert own_nnfm([repeated], network, (2,), length=48.0) == pytest.approx(0, abs=1e-6)


def test_noise_is_far_from_itself_though_every_feature_is_in_it(network: Vgg):
    noise = torch.rand(48, 48, 3, generator=torch.Generator().manual_seed(0))
    (features,) = style_features(noise, network, (2,), length=48.0)
    assert float(nnfm_loss(features, features)) < 1e-6
    own = own_nnfm([noise], network, (2,), length=48.0)
    assert own is not None and own > 0.005


def test_a_copy_among_the_pictures_is_elsewhere(network: Vgg):
    noise = torch.rand(48, 48, 3, generator=torch.Generator().manual_seed(0))
    assert own_nnfm([noise, noise], network, (2,), length=48.0) == pytest.approx(0, abs=1e-6)


def test_a_picture_that_no_two_places_fit_into(network: Vgg):
    noise = torch.rand(14, 14, 3, generator=torch.Generator().manual_seed(0))
    assert own_nnfm([noise], network, (2,), length=14.0) is None


@pytest.mark.parametrize(
    ("after", "share"), [(0.3, 0.0), (0.2, 0.5), (0.1, 1.0), (0.05, 1.0), (0.4, 0.0)]
)
def test_the_share_of_the_way(after: float, share: float):
    assert share_of_way(0.3, after, 0.1) == pytest.approx(share)


def test_no_way_to_go():
    assert share_of_way(0.1, 0.05, 0.1) is None

import pytest
import torch

from scenes import rand
from stylesplat.stylization.config import USUAL_SCALE, StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.style import all_colors, coarsen_style, style_features, style_parts

NOISE = rand(120, 120, 3)


def test_each_of_several_pictures_counts_as_much_as_the_others():
    small, large = torch.zeros(20, 30, 3), rand(90, 70, 3)
    colors = all_colors([small, large])
    assert float((colors == 0).all(dim=1).float().mean()) == 0.5
    assert torch.equal(all_colors([large]), large.view(-1, 3))


def test_features_of_a_flat_style_are_all_the_same(network: FeatureNetwork):
    """Those of the border, which see the padding, would differ."""
    for block in (1, 2):
        feats = style_features(torch.full((30, 40, 3), 0.7), network, block, length=40.0)
        assert len(feats) > 50
        torch.testing.assert_close(feats, feats[:1].expand_as(feats))


@pytest.mark.parametrize(("size", "length"), [((10, 30), 20.0), ((50, 50), 3.0), ((11, 11), 11.0)])
def test_a_style_image_has_at_least_one_whole_feature(
    network: FeatureNetwork, size: tuple[int, int], length: float
):
    assert len(style_features(torch.rand(*size, 3), network, 2, length=length)) >= 1


def test_large_strokes_are_crisp_and_have_no_bristles():
    stripes = 0.5 + 0.3 * torch.cos(torch.arange(120) * 2 * torch.pi / 12)[:, None, None]
    bristles = (stripes + 0.2 * (NOISE - 0.5)).clamp(0, 1)
    for scale in (1.0, USUAL_SCALE):
        assert coarsen_style(bristles, scale) is bristles
    large = coarsen_style(bristles, 4.0)[12:-12, 12:-12]
    assert large.std(dim=1).mean() < 0.5 * bristles.std(dim=1).mean(), "alike along a stroke"
    light = large.mean(dim=(1, 2))
    crisp = (light - light.mean()).abs() > 0.6 * light.std()
    assert crisp.float().mean() > 0.8, "few are between"
    assert bristles.min() <= large.min() and large.max() <= bristles.max()
    faint = 0.5 + 0.01 * NOISE
    assert coarsen_style(faint, 4.0).std() < 0.5 * faint.std(), "flat areas stay flat"


def test_random_parts_stand_for_a_very_large_style_image():
    whole = torch.rand(300, 500, 3)
    config = StyleConfig(scale=1.0)
    (small,) = style_parts([whole], config, 1000.0)
    assert small[0] is whole and small[1] == 1000
    parts = [*style_parts([whole], config, 4000.0)]
    area = sum(part.shape[0] * part.shape[1] for part, _ in parts) * (4000 / 500) ** 2
    assert 0.5e6 < area < 2e6
    assert all(longer == pytest.approx(8 * max(part.shape[:2])) for part, longer in parts)

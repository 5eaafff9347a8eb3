import torch

from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.random_filters import random_network


def weights(network: FeatureNetwork) -> list[torch.Tensor]:
    return [conv.weight for block in network.blocks for conv in block]


def test_seeds_reproduce_and_leave_the_global_generator_alone():
    state = torch.random.get_rng_state()
    one, same, other = random_network(2, 0), random_network(2, 0), random_network(2, 1)
    assert torch.equal(torch.random.get_rng_state(), state)
    assert all(torch.equal(a, b) for a, b in zip(weights(one), weights(same), strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(weights(one), weights(other), strict=True))


def test_shape_is_that_of_vgg16():
    shapes = [tuple(w.shape[:2]) for w in weights(random_network(3, 0))]
    wide = [(64, 3), (64, 64), (128, 64), (128, 128), (256, 128), (256, 256), (256, 256)]
    assert shapes == wide


def test_features_tell_directions_apart():
    network = random_network(3, 0)
    wave = 0.5 + 0.4 * (torch.arange(64) * 0.9).sin()
    across = wave[None, :, None].expand(64, 64, 3)
    cells = network.cells(3)
    inside = cells.inside(64)

    def feats(image: torch.Tensor) -> torch.Tensor:
        return network(image, [3])[0][inside, inside].reshape(-1, 768)

    flat, here, turned = (
        feats(torch.full((64, 64, 3), 0.5)),
        feats(across),
        feats(across.transpose(0, 1)),
    )
    assert torch.cosine_similarity(here[:1], here).min() > 0.8  # wherever it is
    assert torch.cosine_similarity(here[:1], turned).max() < 0.6
    assert torch.cosine_similarity(here[:1], flat).max() < 0.6

import math

import pytest
import torch

from scenes import rand, randn
from stylesplat.scene.splats import Classifier
from stylesplat.training.losses import (
    NEIGHBOR_WEIGHT,
    NO_CLASS,
    depth_phases,
    depth_scatter,
    identity_loss,
    nearest_neighbors,
    neighbor_loss,
    photometric_loss,
    photometric_reference,
    sample_neighbors,
)

CLASSIFIER = Classifier(8 * torch.eye(3, 16), torch.zeros(3), ids=(0, 4, 9))


@pytest.fixture
def images() -> tuple[torch.Tensor, torch.Tensor]:
    image = rand(37, 53, 3)
    return image, (image + 0.1 * randn(37, 53, 3)).clamp(0, 1)


@pytest.mark.parametrize("size", [(37, 53), (5, 4), (40, 64)])
def test_photometric_kernel_matches_torch(images, size: tuple[int, int]):
    image, target = (each[: size[0], : size[1]] for each in images)
    image = 1.2 * image - 0.1  # also below 0 and above 1
    fast, exact = image.clone().requires_grad_(), image.double().requires_grad_()
    loss, error = photometric_loss(fast, target)
    expected, expected_error = photometric_reference(exact, target.double())
    (3 * loss).backward()
    (3 * expected).backward()
    assert fast.grad is not None and exact.grad is not None
    assert abs(loss.item() - expected.item()) < 1e-6
    assert abs(error.item() - expected_error.item()) < 1e-6
    # Float32 against float64: rounding only.
    assert (fast.grad - exact.grad).norm() < 1e-5 * exact.grad.norm()


def test_depths_scatter_as_the_pairs_that_a_pixel_mixes():
    depths, weights = 1 + 9 * rand(6), rand(4, 5, 6) / 6
    apart = 1 - (depths.log()[:, None] - depths.log()).cos()
    pairs = torch.einsum("yxi,yxj,ij->yx", weights, weights, apart).mean()

    def scatter(weights: torch.Tensor) -> float:
        return float(depth_scatter(weights @ depth_phases(depths), weights.sum(-1, keepdim=True)))

    assert scatter(weights) == pytest.approx(float(pairs), rel=1e-4)
    assert scatter(torch.eye(6)[None]) == pytest.approx(0, abs=1e-6), "of one Gaussian each"


def test_identity_loss_rewards_the_right_class_and_a_guess_costs_one():
    classes = torch.tensor([0, 1, 2])
    right = identity_loss(torch.eye(3, 16), classes, CLASSIFIER)
    assert right < 0.01 < identity_loss(torch.eye(3, 16), classes.roll(1), CLASSIFIER)
    assert identity_loss(torch.zeros(3, 16), classes, CLASSIFIER) == pytest.approx(1)
    alone = Classifier(torch.ones(1, 16), torch.zeros(1), ids=(0,))
    assert identity_loss(randn(20, 16), torch.zeros(20, dtype=torch.long), alone) == 0


def test_neighbor_loss():
    same = torch.eye(3, 16)[:, None].expand(-1, 5, -1)
    assert neighbor_loss(torch.eye(3, 16), same, CLASSIFIER).abs() < 1e-6
    # Two classes, of which one Gaussian gives the first 3/4 and its neighbour a half.
    plain = Classifier(torch.eye(2, 16), torch.zeros(2), ids=(0, 1))
    own, other = torch.zeros(1, 16), torch.zeros(1, 1, 16)
    own[0, 0] = math.log(3)
    divergence = 0.75 * math.log(0.75 / 0.5) + 0.25 * math.log(0.25 / 0.5)
    expected = NEIGHBOR_WEIGHT * divergence / 2
    assert neighbor_loss(own, other, plain).item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
def test_nearest_neighbors(device: str):
    means, sample = randn(200, 3), torch.tensor([3, 3, 199, 0])
    distances = (means[sample][:, None] - means).norm(dim=-1)
    distances[torch.arange(4), sample] = torch.inf
    expected = distances.argsort(dim=1)[:, :4]
    found = nearest_neighbors(means.to(device), sample.to(device), 4)
    assert torch.equal(found.cpu(), expected)
    twins = torch.zeros(4, 3)
    assert not (nearest_neighbors(twins, torch.arange(4), 2) == torch.arange(4)[:, None]).any()


def test_of_many_points_some_are_compared():
    means = randn(3000, 3)

    def sampled(max_points: int) -> tuple[torch.Tensor, torch.Tensor]:
        generator = torch.Generator().manual_seed(0)
        return sample_neighbors(means, 1000, 5, generator, max_points=max_points)

    rows, neighbors = sampled(3000)
    assert torch.equal(neighbors, nearest_neighbors(means, rows, 5))
    rows, neighbors = sampled(50)
    some = torch.cat([rows[:, None], neighbors], dim=1).unique()
    assert len(some) == 50 and some.max() > 2000, "from anywhere"
    among = nearest_neighbors(means[some], torch.searchsorted(some, rows), 5)
    assert torch.equal(some[among], neighbors)


def test_pixels_that_are_not_valid_have_no_influence(images):
    image, target = images
    valid = torch.ones(37, 53, dtype=torch.bool)
    valid[5:20, 10:40] = False
    results = []
    for rest in (0.0, 1.0):  # of both images
        fast = image.where(valid[..., None], 1 - rest).requires_grad_()
        loss, error = photometric_loss(fast, target.where(valid[..., None], rest), valid)
        loss.backward()
        assert fast.grad is not None and (fast.grad[~valid] == 0).all()
        results.append((loss.item(), error.item(), fast.grad))
    assert results[0][:2] == results[1][:2] and torch.equal(results[0][2], results[1][2])
    expected = (image - target)[valid].square().mean()
    assert results[0][1] == pytest.approx(float(expected), rel=1e-4)
    nothing, _ = photometric_loss(image, target, torch.zeros_like(valid))
    assert nothing == pytest.approx(0, abs=1e-6)


def test_pixels_without_a_class_cost_nothing():
    classes = torch.tensor([0, 1, 2, NO_CLASS])
    features = torch.eye(3, 16)[[0, 1, 2, 2]]
    expected = identity_loss(features[:3], classes[:3], CLASSIFIER)
    assert identity_loss(features, classes, CLASSIFIER) == pytest.approx(float(expected))
    assert identity_loss(features, torch.full((4,), NO_CLASS), CLASSIFIER) == 0

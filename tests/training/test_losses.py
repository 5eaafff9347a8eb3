import math

import pytest
import torch

from stylesplat.scene.splats import Classifier
from stylesplat.training.losses import (
    NEIGHBOR_WEIGHT,
    identity_loss,
    neighbor_loss,
    photometric_loss,
    photometric_spec,
    split_render,
)


@pytest.fixture
def images() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(37, 53, 3, generator=generator)
    return image, (image + 0.1 * torch.randn(37, 53, 3, generator=generator)).clamp(0, 1)


@pytest.fixture
def classifier() -> Classifier:
    return Classifier(8 * torch.eye(3, 16), torch.zeros(3), ids=(0, 4, 9))


@pytest.mark.parametrize("size", [(37, 53), (5, 4), (40, 64)])
def test_photometric_kernel_matches_torch(images, size: tuple[int, int]):
    image, target = (each[: size[0], : size[1]] for each in images)
    image = 1.2 * image - 0.1  # also below 0 and above 1
    fast, exact = image.clone().requires_grad_(), image.double().requires_grad_()
    (loss, error), expected = (
        photometric_loss(fast, target),
        photometric_spec(exact, target.double()),
    )
    (3 * loss).backward()
    (3 * expected[0]).backward()
    assert fast.grad is not None and exact.grad is not None
    assert abs(loss.item() - expected[0].item()) < 1e-6
    assert abs(error.item() - expected[1].item()) < 1e-6
    # Float32 against float64: rounding only.
    assert (fast.grad - exact.grad).norm() < 1e-5 * exact.grad.norm()


def test_photometric_loss_is_zero_for_equal_images_only(images):
    image, target = images
    assert photometric_loss(image, image)[0].abs() < 1e-6
    assert photometric_loss(image, target)[0] > 0.01


def test_identity_loss_rewards_the_right_class(classifier: Classifier):
    features = torch.eye(3, 16)
    right = identity_loss(features, torch.tensor([0, 1, 2]), classifier)
    wrong = identity_loss(features, torch.tensor([1, 2, 0]), classifier)
    assert right < 0.01 < wrong


def test_untrained_identity_loss_is_one(classifier: Classifier):
    # The division by ln K makes a guess among K classes cost 1, whatever K is.
    features = torch.zeros(5, 16)
    assert identity_loss(features, torch.tensor([0, 1, 2, 0, 1]), classifier) == pytest.approx(1)


def test_neighbor_loss_is_zero_where_labels_agree(classifier: Classifier):
    identities = torch.eye(3, 16)
    same = identities[:, None].expand(-1, 5, -1)
    assert neighbor_loss(identities, same, classifier).abs() < 1e-6
    assert neighbor_loss(identities, same.flip(0), classifier) > 0.1


def features(count: int = 200, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, 16, generator=torch.Generator().manual_seed(seed))


def labels(count: int = 200) -> torch.Tensor:
    return torch.randint(3, (count,), generator=torch.Generator().manual_seed(1))


def test_photometric_loss_of_a_constant_difference():
    # L1 is the difference; both images are flat, so SSIM is that of their luminance, inside.
    image, target = torch.full((60, 60, 3), 0.6), torch.full((60, 60, 3), 0.5)
    luminance = (2 * 0.6 * 0.5 + 1e-4) / (0.36 + 0.25 + 1e-4)
    loss, error = photometric_loss(image, target)
    assert error.item() == pytest.approx(0.01, rel=1e-4)
    # The frame of zeros lowers SSIM near the border, a third of the pixels.
    assert loss.item() == pytest.approx(0.8 * 0.1 + 0.2 * (1 - luminance), abs=0.02)


def test_the_error_is_of_the_clamped_image(images):
    target = images[0]
    loud = target + torch.where(target > 0.5, 5.0, -5.0)
    _, error = photometric_loss(loud, target)
    expected = torch.where(target > 0.5, 1 - target, target).square().mean()
    assert error.item() == pytest.approx(expected.item(), rel=1e-5)


def test_identity_loss_does_not_depend_on_what_classes_are_called(classifier: Classifier):
    swap = torch.tensor([2, 0, 1])
    renamed = Classifier(classifier.weight[swap], classifier.bias[swap], ids=(5, 6, 7))
    places = torch.argsort(swap)  # where each class went
    plain = identity_loss(features(), labels(), classifier)
    other = identity_loss(features(), places[labels()], renamed)
    assert other.item() == pytest.approx(plain.item(), rel=1e-5)


def test_one_class_costs_nothing():
    alone = Classifier(torch.ones(1, 16), torch.zeros(1), ids=(0,))
    assert identity_loss(features(), torch.zeros(200, dtype=torch.long), alone) == 0


def test_neighbor_loss_by_hand():
    # Two classes, of which one Gaussian gives the first 3/4 and its neighbour a half.
    plain = Classifier(torch.eye(2, 16), torch.zeros(2), ids=(0, 1))
    own, other = torch.zeros(1, 16), torch.zeros(1, 1, 16)
    own[0, 0] = math.log(3)
    divergence = 0.75 * math.log(0.75 / 0.5) + 0.25 * math.log(0.25 / 0.5)
    expected = NEIGHBOR_WEIGHT * divergence / 2
    assert neighbor_loss(own, other, plain).item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("offset", "stride"), [((0, 0), 1), ((1, 2), 3), ((4, 0), 5)])
def test_is_what_slices_are(offset: tuple[int, int], stride: int):
    render = torch.randn(7, 11, 19, generator=torch.Generator().manual_seed(0)).requires_grad_()
    colors, features = split_render(render, offset, stride)
    y, x = offset
    expected = render[..., :3], render[y::stride, x::stride, 3:]
    assert torch.equal(colors, expected[0]) and torch.equal(features, expected[1])
    weights = torch.rand_like(colors), torch.rand_like(features)
    (found,) = torch.autograd.grad([colors, features], render, weights)
    (wanted,) = torch.autograd.grad(expected, render, weights)
    assert torch.equal(found, wanted)

import pytest
import torch

from stylesplat.scene.splats import Classifier
from stylesplat.training.losses import (
    identity_loss,
    neighbor_loss,
    photometric_loss,
    photometric_spec,
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

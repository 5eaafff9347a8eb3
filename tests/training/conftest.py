"""A capture that trains in a second: two blobs, id 3 on the left and id 7 on the right."""

import pytest
import torch

from scenes import random_splats
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.training.config import TrainConfig


def ring(count: int) -> Cameras:
    """Cameras on a circle of radius 3 that look at the origin."""
    viewmats = torch.eye(4).repeat(count, 1, 1)
    angles = torch.arange(count) * 2 * torch.pi / count
    viewmats[:, 0, 0], viewmats[:, 0, 2] = angles.cos(), -angles.sin()
    viewmats[:, 2, 0], viewmats[:, 2, 2] = angles.sin(), angles.cos()
    viewmats[:, 2, 3] = 3
    K = torch.tensor([[70.0, 0.0, 36.0], [0.0, 70.0, 32.0], [0.0, 0.0, 1.0]])
    names = tuple(f"{i}.png" for i in range(count))
    return Cameras(
        viewmats, K.repeat(count, 1, 1), torch.tensor([[72, 64]]).repeat(count, 1), names
    )


@pytest.fixture(scope="session")
def cameras() -> Cameras:
    return ring(9)


@pytest.fixture(scope="session")
def capture(cameras: Cameras) -> Capture:
    truth = random_splats(120, sh_degree=0)
    left = torch.arange(len(truth)) < 60
    truth.means.mul_(0.4)
    truth.means[:, 1] += torch.where(left, -0.6, 0.6)
    truth.sh0[left, :, 0] += 2
    ids = torch.where(left, 3.0, 7.0)[:, None]
    photos, maps = [], []
    for row in range(len(cameras)):
        image, alphas, _ = rasterize(truth, cameras[row], features=ids)
        photos.append((image[0, ..., :3].clamp(0, 1) * 255).round().to(torch.uint8))
        label = torch.where(image[0, ..., 3] / alphas[0, ..., 0].clamp(min=0.01) > 5, 7, 3)
        maps.append(torch.where(alphas[0, ..., 0] > 0.5, label, 0))
    colors = (truth.sh0[:, 0] * 70 + 128).clamp(0, 255).to(torch.uint8)
    return Capture(cameras, photos, maps, truth.means, colors)


@pytest.fixture
def config() -> TrainConfig:
    """Sixty steps of it, two at a time whatever the machine."""
    return TrainConfig(steps=60, max_gaussians=400, refine_every=20, photos_at_once=2)

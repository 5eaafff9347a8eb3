"""Small scenes that several test files share, built from a seed."""

from dataclasses import replace

import pytest
import torch

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats


def random_splats(count: int = 200, *, seed: int = 0, sh_degree: int = 3) -> Splats:
    """A cloud around the origin with opaque and faint, round and long Gaussians."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Splats(
        means=0.6 * normal(count, 3),
        quats=normal(count, 4),
        scales=0.5 * normal(count, 3) - 2.3,
        opacities=2 * normal(count) + 1,
        sh0=normal(count, 1, 3),
        shN=0.3 * normal(count, (sh_degree + 1) ** 2 - 1, 3),
        identities=normal(count, 16),
    )


def two_cameras() -> Cameras:
    """Two views of the origin whose sizes are no multiples of a tile."""
    viewmats = torch.eye(4).repeat(2, 1, 1)
    viewmats[:, 2, 3] = torch.tensor([3.0, 2.0])
    viewmats[1, 0, 3] = 0.2
    K = torch.tensor([[60.0, 0.0, 33.0], [0.0, 70.0, 25.0], [0.0, 0.0, 1.0]])
    sizes = torch.tensor([[70, 52], [70, 52]])
    return Cameras(viewmats, K.repeat(2, 1, 1), sizes, ("first.png", "second.png"))


def leaf(splats: Splats, dtype: torch.dtype) -> Splats:
    """Copies of the tensors that collect gradients."""
    tensors = {k: t.to(dtype, copy=True).requires_grad_() for k, t in splats.tensors().items()}
    return replace(splats, **tensors)


BACKENDS = ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)]
"""The backends that are compared with the reference."""

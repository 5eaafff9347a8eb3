"""The kernels of spherical harmonics against `reference.spherical_harmonics` and its gradients."""

import pytest
import torch

from stylesplat.rendering import cpu
from stylesplat.rendering.reference import spherical_harmonics
from stylesplat.scene.splats import sh_bases


def inputs_of(count: int, bands: int, dtype: torch.dtype) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(bands)
    shapes = (count, 3), (count, 1, 3), (count, sh_bases(bands) - 1, 3)
    drawn = [torch.randn(*shape, generator=generator) for shape in shapes]
    return [t.to(dtype).requires_grad_() for t in drawn]


@pytest.mark.parametrize("count", [1, 50])
@pytest.mark.parametrize("degree, bands", [(0, 0), (0, 3), (1, 1), (1, 2), (2, 2), (2, 3), (3, 3)])
def test_colors_and_gradients_are_the_references(count: int, degree: int, bands: int):
    mine, theirs = (inputs_of(count, bands, t) for t in (torch.float32, torch.float64))
    colors, expected = cpu.spherical_harmonics(degree, *mine), spherical_harmonics(degree, *theirs)
    torch.testing.assert_close(colors.double(), expected, atol=1e-5, rtol=0)  # float32
    weights = torch.randn(colors.shape, generator=torch.Generator().manual_seed(9))
    (colors * weights).sum().backward()
    (expected * weights).sum().backward()
    for found, wanted in zip(mine, theirs, strict=True):
        assert found.grad is not None
        gradient = torch.zeros_like(wanted) if wanted.grad is None else wanted.grad
        torch.testing.assert_close(found.grad.double(), gradient, atol=2e-5, rtol=1e-4)  # float32
    if count > 1:
        assert (expected == 0).any()  # some are clamped, and have no gradient

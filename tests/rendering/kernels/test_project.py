"""The projection kernels against the reference, one camera and Gaussian at a time."""

import pytest
import torch

from scenes import random_splats, two_cameras
from stylesplat.rendering import cpu, reference
from stylesplat.rendering.gaussians import Gaussians, activated, views_of

FIRST, SECOND = views_of(two_cameras())
TURNED = SECOND._replace(
    viewmat=SECOND.viewmat
    @ torch.block_diag(
        reference.rotation_matrices(torch.tensor([[0.9, 0.2, -0.3, 0.1]]))[0], torch.ones(1, 1)
    )
)
VIEWS = {
    "first": FIRST,
    "second": SECOND,
    "turned": TURNED,
    # most lie where the Jacobian is held constant, in x or in y
    "narrow": FIRST._replace(width=7, height=90),
    "flat": FIRST._replace(width=90, height=7),
}


def gaussians_of(count: int) -> Gaussians:
    return activated(random_splats(count))


def double(noun):
    return type(noun)(*(t.double() if isinstance(t, torch.Tensor) else t for t in noun))


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("count", [1, 16, 17, 200])
def test_projection_is_the_references(name: str, count: int):
    found = cpu.project_gaussians(gaussians_of(count), VIEWS[name])
    expected = reference.project(double(gaussians_of(count)), double(VIEWS[name]))
    seen = (expected.radii > 0).all(dim=1)
    assert torch.equal(seen, (found.radii > 0).all(dim=1))
    for name_, wanted in expected._asdict().items():
        given = getattr(found, name_)
        assert given.shape == wanted.shape
        assert not given[~seen].any(), name_  # what is not seen is 0, not left over
        if name_ == "radii":  # rounding up may fall on either side of a whole number
            assert ((given - wanted)[seen].abs() <= 1).all()
        else:  # float32; conics of long Gaussians near the camera have lost a few digits
            torch.testing.assert_close(given[seen].double(), wanted[seen], rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("count", [1, 17, 200])
def test_gradients_are_the_references(name: str, count: int):
    view, gradients = VIEWS[name], []
    weights = torch.randn(count, 5, generator=torch.Generator().manual_seed(0))
    for project, cast in ((cpu.project_gaussians, lambda noun: noun), (reference.project, double)):
        inputs = Gaussians(*(t.clone().requires_grad_() for t in cast(gaussians_of(count))))
        found = project(inputs, cast(view))
        seen = (found.radii > 0).all(dim=1)[:, None]
        outputs = torch.cat([found.means2d, found.conics], dim=1)
        torch.where(seen, outputs * weights, 0).sum().backward()
        gradients.append(inputs[:3])
    for mine, wanted in zip(*gradients, strict=True):
        assert mine.grad is not None and wanted.grad is not None
        # DESIGN's bound for float32 kernels
        error = (mine.grad.double() - wanted.grad).norm()
        assert error <= 1e-3 * wanted.grad.norm() + 1e-12

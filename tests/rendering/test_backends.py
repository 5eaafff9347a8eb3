"""Every backend draws what the reference draws, and its gradients are the reference's."""

from dataclasses import replace

import pytest
import torch

from scenes import BACKENDS, leaf, random_splats, two_cameras
from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.scene.splats import Splats

BACKGROUND = torch.tensor([0.2, 0.3, 0.4])
# Float32 against float64: rounding alone. A wrong term in a derivative is larger by far.
IMAGE_TOLERANCE = 2e-4
GRADIENT_TOLERANCE = 1e-3


def draw(splats: Splats, backend: Backend, dtype: torch.dtype, **options):
    """Render, and weigh every output so that all gradients are non-trivial."""
    device = "cuda" if backend == "cuda" else "cpu"
    splats = leaf(splats.to(device), dtype)
    features = splats.identities if options.pop("identities", True) else None
    colors, alphas, info = rasterize(
        splats, two_cameras(), features=features, background=BACKGROUND, backend=backend, **options
    )
    generator = torch.Generator().manual_seed(1)
    for image in (colors, alphas):
        weights = torch.randn(image.shape, generator=generator, dtype=torch.float64)
        (image * weights.to(image)).sum().backward(retain_graph=True)
    return splats, colors.detach().cpu(), alphas.detach().cpu(), info


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("options", [{}, {"identities": False}, {"sh_degree": 1}], ids=str)
def test_image_matches_reference(backend: Backend, options: dict):
    expected = draw(random_splats(), "reference", torch.float64, **options)
    actual = draw(random_splats(), backend, torch.float32, **options)
    for image, other in zip(expected[1:3], actual[1:3], strict=True):
        assert (image - other).abs().max() < IMAGE_TOLERANCE
    seen = (expected[3]["radii"] > 0).all(-1)
    assert torch.equal(seen, (actual[3]["radii"].cpu() > 0).all(-1))
    if backend == "cpu":  # gsplat and the reference differentiate depths too
        assert not actual[3]["depths"].requires_grad
    for name in ("means2d", "depths", "conics"):
        difference = expected[3][name] - actual[3][name].cpu()
        assert difference[seen].abs().max() < 1e-3 * expected[3][name][seen].abs().max()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("options", [{}, {"features_move_geometry": False}], ids=str)
def test_gradients_match_reference(backend: Backend, options: dict):
    expected = draw(random_splats(), "reference", torch.float64, **options)[0].tensors()
    actual = draw(random_splats(), backend, torch.float32, **options)[0].tensors()
    for name, tensor in expected.items():
        assert tensor.grad is not None, name
        reference = tensor.grad.flatten()
        other = actual[name].grad
        assert other is not None, name
        gradient = other.flatten().cpu().double()
        assert (gradient - reference).norm() < GRADIENT_TOLERANCE * reference.norm(), name
        assert torch.cosine_similarity(gradient, reference, dim=0) > 0.9999, name


def test_reference_gradients_are_those_of_its_image():
    splats = random_splats(6, seed=3)
    camera = two_cameras()[:1].downscale(8)
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    inputs = [t.double().requires_grad_() for n, t in splats.tensors().items() if n in names]

    def image(*tensors: torch.Tensor) -> torch.Tensor:
        scene = Splats(**dict(zip(names, tensors, strict=True)))
        return rasterize(scene, camera, backend="reference")[0]

    assert torch.autograd.gradcheck(image, inputs, eps=1e-7, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_unseen_gaussians_have_no_gradient(backend: Backend):
    splats = random_splats(20)
    behind = replace(splats, means=splats.means - torch.tensor([0.0, 0.0, 10.0]))
    drawn, colors, alphas, _ = draw(behind, backend, torch.float32)
    assert alphas.abs().max() == 0
    assert torch.equal(colors[..., :3], BACKGROUND.expand_as(colors[..., :3]))
    assert all(t.grad is None or not t.grad.any() for t in drawn.tensors().values())

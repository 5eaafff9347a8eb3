"""Every backend draws what the reference draws, and its gradients are the reference's."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from scenes import BACKENDS, device_of, leaf, random_splats, two_cameras, weigh_and_backward
from stylesplat.rendering import cpu
from stylesplat.rendering.render import Backend, rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

BACKGROUND = torch.tensor([0.2, 0.3, 0.4])
# Float32 against float64: rounding alone. A wrong term in a derivative is larger by far.
IMAGE_TOLERANCE = 2e-4
GRADIENT_TOLERANCE = 1e-3


def draw(
    splats: Splats,
    backend: Backend,
    dtype: torch.dtype,
    *,
    cameras: Cameras | None = None,
    **options,
):
    """Render, and weigh every output so that all gradients are non-trivial."""
    device = device_of(backend)
    splats = leaf(splats.to(device), dtype)
    features = splats.identities if options.pop("identities", True) else None
    cameras = cameras or two_cameras()
    colors, alphas, info = rasterize(
        splats, cameras, features=features, background=BACKGROUND, backend=backend, **options
    )
    weigh_and_backward(colors, alphas)
    return splats, colors.detach().cpu(), alphas.detach().cpu(), info


def assert_same_gradients(expected: Splats, actual: Splats) -> None:
    """All that the reference has, by size and by direction."""
    for name, tensor in expected.tensors().items():
        other = actual.tensors()[name].grad
        if tensor.grad is None or not tensor.grad.any():
            assert other is None or not other.any(), name
            continue
        assert other is not None, name
        reference, gradient = tensor.grad.flatten(), other.flatten().cpu().double()
        assert (gradient - reference).norm() < GRADIENT_TOLERANCE * reference.norm(), name
        assert torch.cosine_similarity(gradient, reference, dim=0) > 0.9999, name


PLAIN_OPTIONS = [{}, {"identities": False}, {"sh_degree": 1}, {"features_move_geometry": False}]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("options", PLAIN_OPTIONS, ids=str)
def test_image_and_gradients_match_the_reference(backend: Backend, options: dict):
    expected = draw(random_splats(), "reference", torch.float64, **options)
    actual = draw(random_splats(), backend, torch.float32, **options)
    for image, other in zip(expected[1:3], actual[1:3], strict=True):
        assert (image - other).abs().max() < IMAGE_TOLERANCE
    seen = (expected[3]["radii"] > 0).all(-1)
    assert torch.equal(seen, (actual[3]["radii"].cpu() > 0).all(-1))
    if backend != "gsplat":  # as the reference it differentiates depths too
        assert not actual[3]["depths"].requires_grad
    for name in ("means2d", "depths", "conics"):
        difference = expected[3][name] - actual[3][name].cpu()
        assert difference[seen].abs().max() < 1e-3 * expected[3][name][seen].abs().max()
    assert_same_gradients(expected[0], actual[0])


def view(width: int, height: int) -> Cameras:
    """A part of the second view."""
    return two_cameras()[1:].crop((20, 12), (width, height))


def near_plane() -> Splats:
    """Gaussians around the near plane of the second camera, which is at depth 2."""
    splats = random_splats(60)
    depths = torch.linspace(-0.05, 0.3, 60)[:, None] * torch.tensor([0.0, 0.0, 1.0])
    return replace(splats, means=0.02 * splats.means + depths - torch.tensor([0.2, 0.0, 2.0]))


def smaller(*sizes: float) -> Splats:
    """Antialiased Gaussians, about a pixel in size."""
    splats = random_splats()
    return replace(splats, scales=splats.scales + torch.tensor(sizes), antialiased=True)


def limits() -> Splats:
    """Flat, thin and endless Gaussians, opaque and transparent ones, as files of others have."""
    splats = random_splats(24)
    scales, opacities = splats.scales.clone(), splats.opacities.clone()
    scales[:4, 2], scales[4:8, 1:], scales[8:10] = -23.0, -23.0, -23.0
    scales[10], scales[11, :2] = 88.0, 30.0
    opacities[10:12], opacities[12:16], opacities[16:20] = -3.0, 100.0, -100.0
    return replace(splats, scales=scales, opacities=opacities)


def crowd() -> Splats:
    """Faint Gaussians that each cover the whole image."""
    splats = random_splats(9000)
    return replace(splats, scales=splats.scales + 2, opacities=torch.full((9000,), -5.0))


HARD: dict[str, tuple[Callable[[], Splats], Cameras]] = {
    "one pixel": (random_splats, view(1, 1)),
    "one column": (random_splats, view(1, 37)),
    "a tile": (random_splats, view(16, 16)),
    "a tile and a pixel": (random_splats, view(17, 17)),
    "prime": (random_splats, view(31, 13)),
    # most lie where the Jacobian is held constant, in x or in y
    "narrow": (random_splats, replace(two_cameras()[:1], sizes=torch.tensor([[7, 90]]))),
    "flat": (random_splats, replace(two_cameras()[:1], sizes=torch.tensor([[90, 7]]))),
    "one Gaussian": (lambda: random_splats(1, seed=4), two_cameras()),
    "seventeen Gaussians": (lambda: random_splats(17), two_cameras()),
    "no Gaussian": (lambda: random_splats(5)[torch.zeros(5, dtype=torch.bool)], two_cameras()),
    "huge": (lambda: replace(random_splats(20), scales=random_splats(20).scales + 4), view(40, 30)),
    "points": (lambda: replace(random_splats(), scales=random_splats().scales - 6), view(40, 30)),
    "needles": (  # 20 to 1; at 400 to 1 float32 loses digits, the reference's as well
        lambda: replace(
            random_splats(), scales=random_splats().scales + torch.tensor([1.0, -2.0, -2.0])
        ),
        view(40, 30),
    ),
    "antialiased": (lambda: replace(random_splats(), antialiased=True), two_cameras()),
    "antialiased points": (lambda: smaller(-2.0), view(40, 30)),
    "antialiased discs": (lambda: smaller(-1.0, -1.0, -4.0), view(40, 30)),
    "antialiased needles": (lambda: smaller(0.0, -3.0, -3.0), view(40, 30)),
    "limits": (limits, view(40, 30)),
    "antialiased limits": (lambda: replace(limits(), antialiased=True), view(40, 30)),
    "around the near plane": (near_plane, two_cameras()[1:]),
    "one depth": (
        lambda: replace(random_splats(), means=random_splats().means * torch.tensor([1, 1, 0])),
        view(40, 30),
    ),
    "opaque": (
        lambda: replace(random_splats(), opacities=random_splats().opacities + 8), view(40, 30)
    ),
    "faint": (
        lambda: replace(random_splats(), opacities=random_splats().opacities - 6), view(40, 30)
    ),
    "thousands in a tile": (crowd, view(8, 8)),  # more than a GPU sorts in its shared memory
    "no bands": (lambda: random_splats(sh_degree=0), view(40, 30)),
    "one band": (lambda: random_splats(sh_degree=1), view(40, 30)),
    "two bands": (lambda: random_splats(sh_degree=2), view(40, 30)),
}  # fmt: skip


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", HARD)
def test_hard_scenes_match_the_reference(backend: Backend, name: str):
    scene, cameras = HARD[name]
    expected = draw(scene(), "reference", torch.float64, cameras=cameras)
    actual = draw(scene(), backend, torch.float32, cameras=cameras)
    for image, other in zip(expected[1:3], actual[1:3], strict=True):
        assert image.shape == other.shape
        # a Gaussian at the edge of an alpha cut (1/255) may fall on the other side in float32
        assert (image - other).abs().max() < 1.5 / 255 * image.abs().max().clamp(min=1)
        assert (image - other).abs().mean() < IMAGE_TOLERANCE
    assert_same_gradients(expected[0], actual[0])


@pytest.mark.parametrize("groups", [1, 2, 5])
def test_bounded_gradient_rows_add_up_to_the_same(monkeypatch: pytest.MonkeyPatch, groups: int):
    expected = draw(random_splats(), "cpu", torch.float32)[0]
    monkeypatch.setattr(cpu, "get_num_threads", lambda: 5)
    monkeypatch.setattr(cpu, "PARTIAL_BYTES", groups * 200 * 32 * 4)  # rows of 200 Gaussians
    assert groups <= len(cpu.partial_sums(200, 32)) <= 5
    actual = draw(random_splats(), "cpu", torch.float32)[0]
    for name, tensor in expected.tensors().items():
        gradient = actual.tensors()[name].grad
        assert tensor.grad is not None and gradient is not None
        # float32 sums in another order
        assert (gradient - tensor.grad).norm() < 1e-5 * tensor.grad.norm(), name


@pytest.mark.parametrize("backend", BACKENDS)
def test_unseen_gaussians_have_no_gradient(backend: Backend):
    splats = random_splats(20)
    behind = replace(splats, means=splats.means - torch.tensor([0.0, 0.0, 10.0]))
    drawn, colors, alphas, _ = draw(behind, backend, torch.float32)
    assert alphas.abs().max() == 0
    assert torch.equal(colors[..., :3], BACKGROUND.expand_as(colors[..., :3]))
    assert all(t.grad is None or not t.grad.any() for t in drawn.tensors().values())

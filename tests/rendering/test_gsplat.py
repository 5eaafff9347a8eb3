"""The GPU backend's way through gsplat, on any machine: see `native_gsplat.py`."""

import pytest
import torch

from rendering.native_gsplat import Calls, install
from scenes import leaf, random_splats, two_cameras
from stylesplat.rendering.render import Backend, rasterize

# Both sides are float64 and the same formulas; only the order of sums differs.
ROUNDING = 1e-10
SPLATS = random_splats(60)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    return install(monkeypatch)


def features_of(count: int) -> torch.Tensor:
    return torch.randn(len(SPLATS), count, generator=torch.Generator().manual_seed(count))


def drawn(backend: Backend, count: int, moves: bool):
    splats = leaf(SPLATS, torch.float64)
    features = features_of(count).double().requires_grad_() if count else None
    image, alphas, info = rasterize(
        splats, two_cameras(), features=features, features_move_geometry=moves, backend=backend
    )
    generator = torch.Generator().manual_seed(1)
    for each in (image, alphas):
        weights = torch.randn(each.shape, generator=generator, dtype=torch.float64)
        (each * weights).sum().backward(retain_graph=True)
    gradients = {name: t.grad for name, t in splats.tensors().items() if name != "identities"}
    gradients |= {"features": features.grad} if features is not None else {}
    return image, alphas, info, gradients


@pytest.mark.parametrize(
    ("count", "moves", "passes"),
    [
        (0, True, [3]),
        (0, False, [3]),
        (1, True, [4]),
        (16, False, [3, 16]),
        (16, True, [32]),  # 19 are padded to the next that is compiled
        (40, False, [3, 32, 8]),
        (40, True, [32, 16]),
    ],
)
def test_images_and_gradients_are_the_references_and_each_channel_is_blended_once(
    calls: Calls, count: int, moves: bool, passes: list[int]
):
    *expected, projected, gradients = drawn("reference", count, moves)
    *found, given_info, others = drawn("cuda", count, moves)
    for wanted, given in zip(expected, found, strict=True):
        assert wanted.shape == given.shape
        assert (wanted - given).abs().max() < ROUNDING
    assert given_info.keys() == projected.keys()
    assert all(torch.equal(given_info[name], projected[name]) for name in projected)
    for name, gradient in gradients.items():
        other = others[name]
        assert gradient is not None and other is not None, name
        assert (gradient - other).norm() < ROUNDING * (1 + gradient.norm()), name
    assert calls.blended_channels == passes and calls.projections == calls.sorts == 1


@pytest.mark.parametrize("moves", [True, False])
def test_nothing_goes_through_the_host(calls: Calls, moves: bool):
    # Tensors on "meta" have no numbers: to read one, or to mix devices, is an error.
    splats, features = SPLATS.to("meta"), features_of(16).to("meta")
    image, alphas, info = rasterize(
        splats,
        two_cameras(),
        features=features,
        features_move_geometry=moves,
        background=torch.zeros(3, device="meta"),
        backend="cuda",
    )
    assert image.shape == (2, 52, 70, 19) and alphas.shape == (2, 52, 70, 1)
    assert all(t.is_meta for t in (image, alphas, *info.values()))

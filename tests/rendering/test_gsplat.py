"""The backend gsplat, on any machine: see `native_gsplat.py`."""

from dataclasses import replace

import pytest
import torch

from rendering.native_gsplat import Calls, install
from scenes import leaf, randn, random_splats, two_cameras, weigh_and_backward
from stylesplat.rendering.render import Backend, rasterize
from stylesplat.rendering.surface import front_depth
from stylesplat.rendering.weights import backproject, composite

# Both sides are float64 and the same formulas; only the order of sums differs.
ROUNDING = 1e-10
SPLATS = random_splats(30)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    return install(monkeypatch)


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("backend", ["reference", "cpu", "gsplat"])
def test_of_no_gaussians_nothing_is_drawn(backend: Backend):
    none = SPLATS[torch.zeros(len(SPLATS), dtype=torch.bool)]
    features = torch.zeros(0, 16, requires_grad=True)
    image, alphas, info = rasterize(none, two_cameras(), features=features, backend=backend)
    image.sum().backward()
    assert image.shape[-1] == 19 and not image.any() and not alphas.any()
    assert info["radii"].shape == (2, 0, 2) and features.grad is not None


def drawn(backend: Backend, count: int, moves: bool, antialiased: bool):
    splats = leaf(replace(SPLATS, antialiased=antialiased), torch.float64)
    features = randn(len(SPLATS), count, seed=count).double().requires_grad_() if count else None
    image, alphas, info = rasterize(
        splats, two_cameras(), features=features, features_move_geometry=moves, backend=backend
    )
    weigh_and_backward(image, alphas)
    gradients = {name: t.grad for name, t in splats.tensors().items() if name != "identities"}
    gradients |= {"features": features.grad} if features is not None else {}
    return image, alphas, info, gradients


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(
    ("count", "moves", "passes"),
    [
        (0, False, [3]),
        (16, True, [16, 3]),
        (40, False, [3, 16, 16, 8]),
        (40, True, [16, 16, 16]),  # 11 are padded to the next that is compiled
    ],
)
def test_images_and_gradients_are_the_references_and_each_channel_is_blended_once(
    calls: Calls, count: int, moves: bool, passes: list[int], antialiased: bool
):
    *expected, projected, gradients = drawn("reference", count, moves, antialiased)
    *found, given_info, others = drawn("gsplat", count, moves, antialiased)
    for wanted, given in zip(expected, found, strict=True):
        assert wanted.shape == given.shape
        assert (wanted - given).abs().max() < ROUNDING
    assert given_info.keys() == projected.keys()
    there = (projected["radii"] > 0).all(dim=-1)
    for name in projected:
        torch.testing.assert_close(
            given_info[name][there], projected[name][there], rtol=1e-14, atol=0
        )
    for name, gradient in gradients.items():
        other = others[name]
        assert gradient is not None and other is not None, name
        assert (gradient - other).norm() < ROUNDING * (1 + gradient.norm()), name
    assert calls.blended_channels == passes and calls.projections == calls.sorts == 1


@pytest.mark.parametrize("count", [0, len(SPLATS)])
def test_weights_are_the_references(calls: Calls, count: int):
    splats, camera = leaf(SPLATS[torch.arange(count)], torch.float64), two_cameras()[0]
    values, image = randn(count, 20).double(), randn(52, 70, 20).double()
    expected, found = (
        [
            composite(splats, camera, values, backend=backend),
            backproject(splats, camera, image, backend=backend),
        ]
        for backend in ("reference", "gsplat")
    )
    for wanted, given in zip(expected, found, strict=True):
        assert wanted.shape == given.shape
        assert (wanted - given).norm() <= ROUNDING * (1 + wanted.norm())
    assert calls.blended_channels == ([16, 4] * 2 if count else [])


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("count", [0, len(SPLATS)])
def test_depths_are_the_references(count: int):
    splats, camera = leaf(SPLATS[torch.arange(count)], torch.float64), two_cameras()[0]
    mask = torch.arange(count) % 3 > 0
    expected, found = (
        front_depth(splats, camera, mask, backend=backend) for backend in ("reference", "gsplat")
    )
    for wanted, given in zip(expected, found, strict=True):
        assert wanted.shape == given.shape == (52, 70) and wanted.any() == bool(count)
        assert (wanted - given).abs().max() < ROUNDING

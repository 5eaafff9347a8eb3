"""The backend gsplat, on any machine: see `native_gsplat.py`."""

import builtins
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from rendering.native_gsplat import Calls, install
from scenes import leaf, randn, random_splats, two_cameras, weigh_and_backward
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.reference import rasterizer
from stylesplat.rendering.render import Backend, rasterize
from stylesplat.rendering.surface import front_depth
from stylesplat.rendering.weights import backproject, composite

gsplat = pytest.importorskip("gsplat")

# Both sides are float64 and the same formulas; only the order of sums differs.
ROUNDING = 1e-10
SPLATS = random_splats(30)


@pytest.fixture(params=["1.5.3", "1.6"])
def calls(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Calls:
    calls = install(monkeypatch)
    if request.param == "1.6":
        install_newer_signatures(monkeypatch)
    return calls


def install_newer_signatures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of gsplat 1.6 that differ, with what 1.5.3 computes; 1.6 is not on PyPI."""
    harmonics, tiles = gsplat.spherical_harmonics, gsplat.isect_tiles

    def spherical_harmonics(
        degrees_to_use: int, means: Tensor, viewmats: Tensor, coeffs: Tensor, masks: None = None
    ) -> Tensor:
        rotations, moves = viewmats[:, :3, :3], viewmats[:, :3, 3]
        origins = -(rotations.transpose(1, 2) @ moves[..., None])[..., 0]  # [C, 3]
        return torch.stack([harmonics(degrees_to_use, means - each, coeffs) for each in origins])

    def isect_tiles(
        *given: Any, conics: Tensor | None = None, opacities: Tensor | None = None
    ) -> Any:
        assert conics is not None and opacities is not None
        _, radii, depths, *_ = given
        assert conics.shape[:2] == opacities.shape == depths.shape == radii.shape[:2]
        return tiles(*given)

    monkeypatch.setattr(gsplat, "spherical_harmonics", spherical_harmonics)
    monkeypatch.setattr(gsplat, "isect_tiles", isect_tiles)


def test_a_gaussian_is_as_opaque_as_the_installed_version_lets_it_get(
    monkeypatch: pytest.MonkeyPatch,
):
    install(monkeypatch)
    solid, camera = (
        replace(
            SPLATS[torch.arange(1)], opacities=torch.full((1,), 20.0), scales=torch.zeros(1, 3)
        ),
        two_cameras()[0],
    )
    ahead = torch.linalg.inv(camera.viewmats[0])[:3] @ torch.tensor([0.0, 0.0, 3.0, 1.0])
    solid = leaf(replace(solid, means=ahead[None]), torch.float64)
    _, covered = front_depth(solid, camera, torch.ones(1, dtype=torch.bool), backend="gsplat")
    assert float(covered.max()) == pytest.approx(0.999, abs=1e-9)
    constants = SimpleNamespace(MAX_ALPHA=0.99)
    monkeypatch.setitem(sys.modules, "gsplat.cuda._constants", constants)  # as in 1.6
    _, covered = front_depth(solid, camera, torch.ones(1, dtype=torch.bool), backend="gsplat")
    assert float(covered.max()) == pytest.approx(0.99, abs=1e-9)


BUILD_LOG = """Error building extension 'gsplat_cuda': [1/12] nvcc -c Projection.cu
In file included from Projection.cu:4:
/usr/include/glm.hpp(12): error: identifier "nothing" is undefined
1 error detected in the compilation of "Projection.cu"."""


def failing_import(error: Exception) -> Callable[..., Any]:
    """Importing gsplat fails, all else does not."""
    real = builtins.__import__

    def load(name: str, *rest: Any, **more: Any) -> Any:
        if name == "gsplat":
            raise error
        return real(name, *rest, **more)

    return load


@pytest.mark.parametrize("compiles_at_import", [False, True], ids=["1.5.3", "1.6"])
@pytest.mark.parametrize(
    ("error", "fact"),
    [
        (None, "gsplat finds no CUDA toolkit"),
        (RuntimeError(BUILD_LOG), r"kernels: /usr/include/glm.hpp\(12\): error: .* undefined"),
        (OSError("csrc.so: undefined symbol"), "kernels: csrc.so: undefined symbol"),
        (ImportError(), "Cannot compile gsplat's kernels"),
    ],
    ids=["no toolkit", "no build", "no library", "nothing said"],
)
def test_without_its_kernels_a_line_says_why_and_what_helps(
    monkeypatch: pytest.MonkeyPatch,
    error: Exception | None,
    fact: str,
    compiles_at_import: bool,
):
    class Backend(ModuleType):
        @property
        def _C(self) -> None:
            if error:
                raise error

    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", Backend("gsplat.cuda._backend"))
    adapter = "stylesplat.rendering.through_gsplat"
    import_module(adapter).require_kernels.cache_clear()
    if compiles_at_import and error:
        monkeypatch.delitem(sys.modules, adapter)
        monkeypatch.setattr("builtins.__import__", failing_import(error))
    with pytest.raises(StyleSplatError, match=fact) as caught:
        rasterizer("gsplat", torch.device("cuda"))
    assert "backend cuda, which needs neither" in str(caught.value)
    assert "\n" not in str(caught.value)


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

"""Gradients by the cameras' poses: the reference's in every backend, and good for finding them."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from rendering.native_gsplat import install
from scenes import BACKENDS, device_of, random_splats, two_cameras, weigh_and_backward
from stylesplat.rendering import cpu
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.render import Backend, rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import Splats

TURN = torch.block_diag(
    rotation_matrices(torch.tensor([[0.9, 0.2, -0.3, 0.1]]))[0], torch.ones(1, 1)
)
Carried = Callable[[Splats, Cameras], Tensor]


def turned_cameras() -> Cameras:
    """Views whose axes are none of the world's, so that no transposed matrix goes unnoticed."""
    return replace(two_cameras(), viewmats=two_cameras().viewmats @ TURN)


def cast(splats: Splats, cameras: Cameras, backend: Backend, dtype: torch.dtype):
    """Both for a backend; of these only the poses collect gradients."""
    device = device_of(backend)
    tensors = {name: t.to(device, dtype) for name, t in splats.tensors().items()}
    viewmats = cameras.viewmats.to(device, dtype, copy=True).requires_grad_()
    return replace(splats, **tensors), replace(cameras, viewmats=viewmats)


def pose_gradients(
    backend: Backend,
    dtype: torch.dtype,
    *,
    splats: Splats | None = None,
    cameras: Cameras | None = None,
    carried: Carried | None = None,
    **options,
) -> Tensor:
    """Of a loss that weighs every number of image and coverage."""
    splats, cameras = cast(splats or random_splats(60), cameras or turned_cameras(), backend, dtype)
    features = None if carried is None else carried(splats, cameras)
    weigh_and_backward(
        *rasterize(splats, cameras, features=features, backend=backend, **options)[:2]
    )
    gradients = cameras.viewmats.grad
    assert gradients is not None
    return gradients.cpu().double()


def assert_same(found: Tensor, expected: Tensor, tolerance: float) -> None:
    """View by view, by size and by direction."""
    assert found.shape == expected.shape
    assert not found[:, 3].any()
    for mine, wanted in zip(found, expected, strict=True):
        assert wanted.any()
        assert (mine - wanted).norm() < tolerance * wanted.norm()
        assert torch.cosine_similarity(mine.flatten(), wanted.flatten(), dim=0) > 0.9999


def identities(splats: Splats, cameras: Cameras) -> Tensor:
    assert splats.identities is not None
    return splats.identities


def depths(splats: Splats, cameras: Cameras) -> Tensor:
    return depths_of(splats.means, cameras)[:, None]


CASES = {
    "colour": {},
    "one band": {"sh_degree": 1},
    "identities": {"carried": identities},
    "identities that move nothing": {"carried": identities, "features_move_geometry": False},
    "depths": {"carried": depths, "cameras": turned_cameras()[1]},
    "seventeen Gaussians": {"splats": random_splats(17)},
}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", CASES)
def test_they_are_the_references(backend: Backend, name: str):
    expected = pose_gradients("reference", torch.float64, **CASES[name])
    found = pose_gradients(backend, torch.float32, **CASES[name])
    assert_same(found, expected, 1e-3)  # DESIGN's bound for float32 kernels; 5e-6 was measured


@pytest.mark.parametrize("name", ["one band", "identities that move nothing"])
def test_gsplat_is_asked_for_them(monkeypatch: pytest.MonkeyPatch, name: str):
    install(monkeypatch)
    expected = pose_gradients("reference", torch.float64, **CASES[name])
    assert_same(pose_gradients("gsplat", torch.float64, **CASES[name]), expected, 1e-10)  # rounding


def test_they_are_the_same_every_time_and_almost_so_by_any_number_of_threads(
    monkeypatch: pytest.MonkeyPatch,
):
    expected = pose_gradients("cpu", torch.float32)
    assert torch.equal(pose_gradients("cpu", torch.float32), expected)
    monkeypatch.setattr(cpu, "get_num_threads", lambda: 5)
    assert_same(pose_gradients("cpu", torch.float32), expected, 1e-5)  # blending sums in float32

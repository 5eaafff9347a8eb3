from collections.abc import Iterator

import pytest
import torch

from rendering import emulated_cuda
from scenes import randn
from stylesplat.training import adam
from stylesplat.training.adam import (
    BETA1,
    BETA2,
    EPS,
    AdamUpdate,
    Moments,
    adam_cuda,
    adam_step,
    adam_steps,
)

VISIBLE = torch.tensor([True, False, True, False, False, True])


@pytest.fixture(autouse=True, params=["numba", "cuda"])
def kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Every test runs with the kernel of the CPU, and with that of GPUs, emulated."""
    if request.param == "cuda":
        emulated_cuda.install(monkeypatch)
        monkeypatch.setattr(adam, "adam_cpu", adam_cuda)
    yield request.param


def leaf() -> torch.Tensor:
    return torch.ones(6, 2, 3, requires_grad=True)


def stepped(
    grads: torch.Tensor, visible: torch.Tensor | None = None
) -> tuple[torch.Tensor, Moments]:
    param = leaf()
    moments = Moments.zeros({"x": param})
    for step, gradient in enumerate(grads, start=1):
        param.grad = gradient.clone()
        adam_step({"x": param}, moments, {"x": 0.1}, step, visible)
    return param.detach(), moments


def test_matches_torch():
    ours, theirs = stepped(randn(5, 6, 2, 3))[0], leaf()
    optimizer = torch.optim.Adam([theirs], lr=0.1, betas=(BETA1, BETA2), eps=EPS)
    for gradient in randn(5, 6, 2, 3):
        theirs.grad = gradient.clone()
        optimizer.step()
    assert torch.allclose(ours, theirs, atol=1e-5)


def test_only_visible_rows_are_stepped():
    some, moments = stepped(randn(5, 6, 2, 3), VISIBLE)
    assert torch.equal(some[VISIBLE], stepped(randn(5, 6, 2, 3))[0][VISIBLE])
    assert torch.equal(some[~VISIBLE], torch.ones(3, 2, 3))
    assert not moments.first["x"][~VISIBLE].any() and not moments.second["x"][~VISIBLE].any()
    weight = torch.ones(3, 16, requires_grad=True)  # has another number of rows
    weight.grad = torch.ones(3, 16)
    adam_step({"w": weight}, Moments.zeros({"w": weight}), {"w": 0.1}, 1, VISIBLE)
    assert (weight != 1).all()


def test_updates_are_taken_one_after_the_other():
    grads = randn(3, 6, 2, 3)
    param = leaf()
    moments, updates = Moments.zeros({"x": param}), []
    for step, gradient in enumerate(grads, start=1):
        shared = param.detach().requires_grad_()
        shared.grad = gradient
        updates.append(AdamUpdate({"x": shared}, {"x": 0.1}, step, VISIBLE))
    adam_steps(moments, updates)
    expected, alone = stepped(grads, VISIBLE)
    torch.testing.assert_close(param.detach(), expected, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(moments.second["x"], alone.second["x"], atol=1e-6, rtol=1e-5)


def test_a_step_for_several_photos_is_longer_and_remembers_less():
    param = torch.ones(4, dtype=torch.float32, requires_grad=True)
    first, second, gradient = randn(4), randn(4, seed=1) ** 2, torch.tensor([1.0, -2, 3, 0])
    moments = Moments({"x": first.clone()}, {"x": second.clone()})
    param.grad = gradient
    adam_steps(moments, [AdamUpdate({"x": param}, {"x": 0.1}, 12)], photos=3)
    mean = first.double() * BETA1**3 + gradient * (1 - BETA1**3)
    square = second.double() * BETA2**3 + gradient**2 * (1 - BETA2**3)
    root = (square / (1 - BETA2**12)).sqrt()
    expected = 1 - 3**0.5 * 0.1 * (mean / (1 - BETA1**12)) / (root + EPS)
    assert torch.allclose(moments.first["x"].double(), mean, atol=1e-6)
    assert torch.allclose(moments.second["x"].double(), square, atol=1e-6)
    assert torch.allclose(param.detach().double(), expected, atol=1e-5)


def test_the_layout_in_memory_is_irrelevant(kernel: str):
    if kernel == "cuda":
        pytest.skip("training keeps its tensors contiguous")
    plain = torch.ones(10, 3, requires_grad=True)
    transposed = torch.ones(3, 10).T.requires_grad_()
    for param in (plain, transposed):
        moments = Moments.zeros({"x": param})
        for step in (1, 2):
            param.grad = randn(10, 3)
            adam_step({"x": param}, moments, {"x": 0.1}, step)
    assert not transposed.is_contiguous() and (transposed != 1).all()
    assert torch.equal(transposed, plain)

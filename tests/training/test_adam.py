import copy
from typing import NamedTuple

import pytest
import torch

import fake_gsplat
from stylesplat.training.adam import (
    BETA1,
    BETA2,
    EPS,
    AdamTurn,
    AdamUpdate,
    Moments,
    adam_cpu,
    adam_cuda,
    adam_step,
    adam_steps,
)

VISIBLE = torch.tensor([True, False, True, False, False, True])


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def gradients(count: int) -> list[torch.Tensor]:
    generator = seeded()
    return [torch.randn(6, 2, 3, generator=generator) for _ in range(count)]


def leaf() -> torch.Tensor:
    return torch.ones(6, 2, 3, requires_grad=True)


def stepped(
    grads: list[torch.Tensor], visible: torch.Tensor | None = None
) -> tuple[torch.Tensor, Moments]:
    param = leaf()
    moments = Moments.zeros({"x": param})
    for step, gradient in enumerate(grads, start=1):
        param.grad = gradient.clone()
        adam_step({"x": param}, moments, {"x": 0.1}, step, visible)
    return param.detach(), moments


def test_matches_torch():
    ours, theirs = stepped(gradients(5))[0], leaf()
    optimizer = torch.optim.Adam([theirs], lr=0.1, betas=(BETA1, BETA2), eps=EPS)
    for gradient in gradients(5):
        theirs.grad = gradient.clone()
        optimizer.step()
    assert torch.allclose(ours, theirs, atol=1e-5)


def test_only_visible_rows_are_stepped():
    some, moments = stepped(gradients(5), VISIBLE)
    assert torch.equal(some[VISIBLE], stepped(gradients(5))[0][VISIBLE])
    assert torch.equal(some[~VISIBLE], torch.ones(3, 2, 3))
    assert not moments.first["x"][~VISIBLE].any() and not moments.second["x"][~VISIBLE].any()
    weight = torch.ones(3, 16, requires_grad=True)  # has another number of rows
    weight.grad = torch.ones(3, 16)
    adam_step({"w": weight}, Moments.zeros({"w": weight}), {"w": 0.1}, 1, VISIBLE)
    assert (weight != 1).all()


def test_a_step_for_several_photos_is_longer_and_remembers_less():
    param = torch.ones(4, dtype=torch.float32, requires_grad=True)
    (first, second), gradient = torch.rand(2, 4, generator=seeded()), torch.tensor([1.0, -2, 3, 0])
    moments = Moments({"x": first.clone()}, {"x": second.clone()})
    param.grad = gradient
    adam_steps(moments, [AdamUpdate({"x": param}, {"x": 0.1}, 12)], photos=3)
    mean = first.double() * BETA1**3 + gradient * (1 - BETA1**3)
    square = second.double() * BETA2**3 + gradient**2 * (1 - BETA2**3)
    root = (square / (1 - BETA2**12)).sqrt()
    expected = 1 - 3**0.5 * 0.1 * (mean / (1 - BETA1**12)) / (root + EPS)
    assert torch.allclose(moments.first["x"].double(), mean, atol=1e-6)
    assert torch.allclose(moments.second["x"].double(), square, atol=1e-6)
    assert torch.allclose(param.detach().double(), expected, atol=1e-6)


def test_without_a_gradient_nothing_moves():
    param, other = leaf(), leaf()
    param.grad = torch.ones(6, 2, 3)
    params = {"x": param, "y": other}
    adam_step(params, Moments.zeros(params), {"x": 0.1, "y": 0.1}, 1)
    assert torch.equal(other, leaf()) and not torch.equal(param, leaf())


def test_the_layout_in_memory_is_irrelevant():
    plain = torch.ones(10, 3, requires_grad=True)
    transposed = torch.ones(3, 10).T.requires_grad_()
    gradient = torch.randn(10, 3, generator=seeded())
    for param in (plain, transposed):
        moments = Moments.zeros({"x": param})
        for step in (1, 2):
            param.grad = gradient
            adam_step({"x": param}, moments, {"x": 0.1}, step)
    assert not transposed.is_contiguous() and (transposed != 1).all()
    assert torch.equal(transposed, plain)


def test_taken_rows_keep_their_state_and_fresh_ones_are_zero():
    moments = Moments({"x": torch.arange(3.0), "y": torch.ones(1)}, {"x": torch.ones(3)})
    taken = moments.take(torch.tensor([2, -1, 0]), ("x",))
    assert taken.first["x"].tolist() == [2, 0, 0]
    assert taken.second["x"].tolist() == [1, 0, 1]
    assert taken.first["y"] is moments.first["y"]


class Arguments(NamedTuple):
    param: torch.Tensor
    first: torch.Tensor
    second: torch.Tensor
    turns: list[AdamTurn]
    kept: tuple[float, float] = (BETA1, BETA2)


def arguments(step: int = 3, count: int = 1) -> Arguments:
    generator = seeded()

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    turns = [
        AdamTurn(draw(50, 2, 3), draw(50) > 0, 0.05 / each, (1 - BETA1**each, 1 - BETA2**each))
        for each in range(step, step + count)
    ]
    return Arguments(draw(50, 2, 3), draw(50, 2, 3), draw(50, 2, 3) ** 2, turns)


@pytest.mark.parametrize("step", [1, 3, 1000])
def test_both_devices_agree(monkeypatch: pytest.MonkeyPatch, step: int):
    fake_gsplat.install_training_kernels(monkeypatch)
    one, other = arguments(step, 2), copy.deepcopy(arguments(step, 2))
    adam_cpu(*one)
    adam_cuda(*other)
    for here, there in zip(one[:3], other[:3], strict=True):
        # Rounding: the rates are at most 0.05 and a step is at most some times its rate.
        torch.testing.assert_close(here, there, atol=1e-5, rtol=1e-5)


def test_turns_are_steps_one_after_the_other():
    together, alone = arguments(count=3), arguments(count=3)
    adam_cpu(*together)
    for turn in alone.turns:
        adam_cpu(*alone._replace(turns=[turn]))
    for one, other in zip(together[:3], alone[:3], strict=True):
        torch.testing.assert_close(one, other, atol=1e-6, rtol=1e-5)

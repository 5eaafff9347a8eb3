"""What both devices do, by their own means, is the same; gsplat is a stand-in (`fake_gsplat`)."""

import copy
from types import ModuleType
from typing import NamedTuple, cast

import pytest
import torch

import fake_gsplat
from scenes import random_splats
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.capture import Capture
from stylesplat.training import adam, cpu_ops, densification, losses, step
from stylesplat.training.device_ops import MAX_COPIES, AdamTurn, DeviceOps, Geometry
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig


@pytest.fixture
def cuda(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return fake_gsplat.cuda_ops(monkeypatch)


@pytest.fixture(params=["cpu", "cuda"])
def parts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> DeviceOps:
    """Both, one after the other."""
    return cast(DeviceOps, cpu_ops if request.param == "cpu" else fake_gsplat.cuda_ops(monkeypatch))


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def turn(step: int, seed: int) -> AdamTurn:
    return AdamTurn(
        grad=draw(50, 2, 3, seed=seed),
        visible=draw(50, seed=seed + 1) > 0,
        rate=0.05 / step,
        corrections=(1 - adam.BETA1**step, 1 - adam.BETA2**step),
    )


class AdamArguments(NamedTuple):
    param: torch.Tensor
    first: torch.Tensor
    second: torch.Tensor
    turns: list[AdamTurn]
    kept: tuple[float, float]


def adam_updates(step: int = 3, count: int = 1) -> AdamArguments:
    return AdamArguments(
        param=draw(50, 2, 3),
        first=draw(50, 2, 3, seed=2),
        second=draw(50, 2, 3, seed=3) ** 2,
        turns=[turn(step + number, 10 * number + 4) for number in range(count)],
        kept=(adam.BETA1, adam.BETA2),
    )


def geometry(count: int = 300) -> Geometry:
    splats = random_splats(count)
    splats.opacities.sub_(5)
    return Geometry(*(getattr(splats, name) for name in Geometry._fields))


@pytest.mark.parametrize("step", [1, 3, 1000])
def test_adam_agrees(cuda: ModuleType, step: int):
    one, other = adam_updates(step, 2), copy.deepcopy(adam_updates(step, 2))
    cpu_ops.adam(*one)
    cuda.adam(*other)
    for here, there in zip(one[:3], other[:3], strict=True):
        # Rounding: the rates are at most 0.05 and a step is at most some times its rate.
        torch.testing.assert_close(here, there, atol=2e-6, rtol=1e-5)


def test_adam_leaves_other_rows_bit_equal(parts: DeviceOps):
    before, steps = adam_updates(), adam_updates()
    parts.adam(*steps)
    rows = steps.turns[0].visible
    for name in ("param", "first", "second"):
        old, new = getattr(before, name), getattr(steps, name)
        assert torch.equal(old[~rows], new[~rows])
        assert not torch.isclose(old[rows], new[rows]).all()


def test_adam_s_turns_are_steps_one_after_the_other(parts: DeviceOps):
    together, alone = adam_updates(count=3), adam_updates(count=3)
    parts.adam(*together)
    for each in alone.turns:
        parts.adam(*alone._replace(turns=[each]))
    for one, other in zip(together[:3], alone[:3], strict=True):
        torch.testing.assert_close(one, other, atol=1e-6, rtol=1e-5)


def test_noise_agrees(cuda: ModuleType):
    # The CPU takes noise along a Gaussian's axes, the GPU along the world's.
    one, other, noise = geometry(), geometry(), draw(300, 3)
    turned = (rotation_matrices(one.quats) @ noise[..., None])[..., 0]
    before = one.means.clone()
    cpu_ops.add_noise(one, noise, 100.0)
    cuda.add_noise(other, turned, 100.0)
    # The CPU leaves out those whose share is below a millionth.
    torch.testing.assert_close(one.means, other.means, atol=1e-4, rtol=1e-4)
    assert (one.means - before).abs().max() > 0.1


def relocations() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    opacities = torch.sigmoid(draw(200))
    return opacities, draw(200, 3).exp(), torch.arange(200) % MAX_COPIES + 1


def test_relocation_agrees(cuda: ModuleType):
    opacities, scales, copies = relocations()
    mine, theirs = cpu_ops.relocate(*relocations()), cuda.relocate(opacities, scales, copies)
    torch.testing.assert_close(mine[0], theirs[0], atol=1e-6, rtol=1e-5)
    # gsplat adds alternating terms of up to some hundreds in float32
    torch.testing.assert_close(mine[1], theirs[1], atol=0, rtol=2e-3)
    assert torch.equal(copies, relocations()[2]), "gsplat's clamp must not reach ours"


def test_one_copy_is_the_gaussian_itself(parts: DeviceOps):
    opacities, scales, _ = relocations()
    same = parts.relocate(opacities, scales, torch.ones(200, dtype=torch.long))
    torch.testing.assert_close(same[0], opacities, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(same[1], scales, atol=0, rtol=1e-5)


def test_copies_are_as_opaque_together_as_one_was(parts: DeviceOps):
    opacities, scales, copies = relocations()
    new, _ = parts.relocate(opacities, scales, copies)
    torch.testing.assert_close(1 - (1 - new) ** copies, opacities, atol=1e-4, rtol=0)


def test_nearest_agrees(cuda: ModuleType):
    means, sample = draw(500, 3), torch.arange(0, 500, 3)
    mine, theirs = (part.nearest(means, sample, 5) for part in (cpu_ops, cuda))
    assert torch.equal(mine.sort(dim=1).values, theirs.sort(dim=1).values)


def test_nearest_are_the_nearest(parts: DeviceOps):
    means, sample = draw(200, 3), torch.tensor([3, 3, 199, 0])
    found = parts.nearest(means, sample, 4)
    distances = (means[sample][:, None] - means).norm(dim=-1)
    distances[torch.arange(4), sample] = torch.inf
    assert torch.equal(found, distances.argsort(dim=1)[:, :4])


def test_photometric_losses_agree(cuda: ModuleType):
    image, target = draw(30, 41, 3).sigmoid(), draw(30, 41, 3, seed=1).sigmoid()
    mine, theirs = (part.photometric_loss(image, target, 0.2) for part in (cpu_ops, cuda))
    torch.testing.assert_close(mine, theirs, atol=1e-6, rtol=1e-5)


def test_training_takes_the_same_way_on_both(
    cuda: ModuleType, capture: Capture, monkeypatch: pytest.MonkeyPatch
):
    # Noise, which differs sample by sample, left out; growth and neighbours included.
    config = TrainConfig(steps=12, max_gaussians=200, refine_every=5, identity_every=1)
    monkeypatch.setattr(densification, "NOISE_RATE", 0.0)
    mine = fit(capture, config)
    for module in (adam, densification, step, losses):
        monkeypatch.setattr(module, "device_ops", lambda device: cuda)
    theirs = fit(capture, config)
    assert mine.ids == theirs.ids
    for name, tensor in mine.params.items():
        assert theirs.params[name].dtype == tensor.dtype
        error = (theirs.params[name] - tensor).detach().norm() / tensor.detach().norm()
        # Rounding, which Adam blows up where gradients hardly differ from 0: those of the
        # rotations of Gaussians that are round still are nothing but rounding. A step without its
        # corrections, say, would be three times as long: 0.1.
        assert error < (2e-2 if name == "quats" else 5e-3), name

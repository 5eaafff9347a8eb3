"""What both devices do, by their own means, is the same; gsplat is a stand-in (`fake_gsplat`)."""

import copy
from types import ModuleType
from typing import cast

import pytest
import torch

import fake_gsplat
from scenes import random_splats
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.capture import Capture
from stylesplat.training import adam, cpu_parts, gradients, growth, losses
from stylesplat.training.loop import fit
from stylesplat.training.parts import MAX_COPIES, AdamSteps, Geometry, Parts, Turn, parts_for
from stylesplat.training.train_config import TrainConfig


@pytest.fixture
def cuda(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return fake_gsplat.cuda_parts(monkeypatch)


@pytest.fixture(params=["cpu", "cuda"])
def parts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Parts:
    """Both, one after the other."""
    return cast(Parts, cpu_parts if request.param == "cpu" else fake_gsplat.cuda_parts(monkeypatch))


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def turn(step: int, seed: int) -> Turn:
    return Turn(
        grad=draw(50, 2, 3, seed=seed),
        rows=draw(50, seed=seed + 1) > 0,
        rate=0.05 / step,
        corrections=(1 - adam.BETA1**step, 1 - adam.BETA2**step),
    )


def adam_updates(step: int = 3, count: int = 1) -> AdamSteps:
    return AdamSteps(
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


def test_the_cpu_has_its_parts():
    assert parts_for(torch.device("cpu")) is cpu_parts


def test_the_gpu_has_its_parts(cuda: ModuleType):
    assert parts_for(torch.device("cuda")) is cuda


@pytest.mark.parametrize("name", [name for name in vars(Parts) if not name.startswith("_")])
def test_both_have_every_part(cuda: ModuleType, name: str):
    assert callable(getattr(cpu_parts, name)) and callable(getattr(cuda, name))


@pytest.mark.parametrize("step", [1, 3, 1000])
def test_adam_agrees(cuda: ModuleType, step: int):
    one, other = adam_updates(step, 2), copy.deepcopy(adam_updates(step, 2))
    cpu_parts.adam(one)
    cuda.adam(other)
    for here, there in zip(one[:3], other[:3], strict=True):
        # Rounding: the rates are at most 0.05 and a step is at most some times its rate.
        torch.testing.assert_close(here, there, atol=2e-6, rtol=1e-5)


def test_adam_leaves_other_rows_bit_equal(parts: Parts):
    before, steps = adam_updates(), adam_updates()
    parts.adam(steps)
    rows = steps.turns[0].rows
    for name in ("param", "first", "second"):
        old, new = getattr(before, name), getattr(steps, name)
        assert torch.equal(old[~rows], new[~rows])
        assert not torch.isclose(old[rows], new[rows]).all()


def test_adam_s_turns_are_steps_one_after_the_other(parts: Parts):
    together, alone = adam_updates(count=3), adam_updates(count=3)
    parts.adam(together)
    for each in alone.turns:
        parts.adam(alone._replace(turns=[each]))
    for one, other in zip(together[:3], alone[:3], strict=True):
        torch.testing.assert_close(one, other, atol=1e-6, rtol=1e-5)


def test_adam_takes_gradients_that_are_not_contiguous(parts: Parts):
    plain, turned = adam_updates(), adam_updates()
    grad = plain.turns[0].grad.transpose(1, 2).contiguous().transpose(1, 2)
    assert not grad.is_contiguous()
    parts.adam(plain)
    parts.adam(turned._replace(turns=[turned.turns[0]._replace(grad=grad)]))
    assert torch.equal(plain.param, turned.param)


def test_drift_agrees(cuda: ModuleType):
    # The CPU takes noise along a Gaussian's axes, the GPU along the world's.
    one, other, noise = geometry(), geometry(), draw(300, 3)
    turned = (rotation_matrices(one.quats) @ noise[..., None])[..., 0]
    before = one.means.clone()
    cpu_parts.drift(one, noise, 100.0)
    cuda.drift(other, turned, 100.0)
    # The CPU leaves out those whose share is below a millionth.
    torch.testing.assert_close(one.means, other.means, atol=1e-4, rtol=1e-4)
    assert (one.means - before).abs().max() > 0.1


def test_drift_vanishes_for_opaque_gaussians(parts: Parts):
    here = geometry()
    opaque = here._replace(means=here.means.clone(), opacities=torch.full((300,), 3.0))
    parts.drift(opaque, draw(300, 3), 1.0)
    # The gate of opacity 0.95 is exp(-95): nothing is left of it in float32.
    assert torch.equal(opaque.means, here.means)


def test_drift_is_linear_in_its_rate(parts: Parts):
    once, twice = geometry(), geometry()
    before = once.means.clone()
    parts.drift(once, draw(300, 3), 0.5)
    parts.drift(twice, draw(300, 3), 1.0)
    # A difference of numbers near 1: some units of their last place.
    torch.testing.assert_close(2 * (once.means - before), twice.means - before, atol=1e-6, rtol=0)


def test_drift_ignores_the_norm_of_quaternions(parts: Parts):
    one, other = geometry(), geometry()
    parts.drift(one, draw(300, 3), 1.0)
    parts.drift(other._replace(quats=3 * other.quats), draw(300, 3), 1.0)
    torch.testing.assert_close(one.means, other.means, atol=1e-6, rtol=1e-5)


def relocations() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    opacities = torch.sigmoid(draw(200))
    return opacities, draw(200, 3).exp(), torch.arange(200) % MAX_COPIES + 1


def test_relocation_agrees(cuda: ModuleType):
    opacities, scales, copies = relocations()
    mine, theirs = cpu_parts.relocated(*relocations()), cuda.relocated(opacities, scales, copies)
    torch.testing.assert_close(mine[0], theirs[0], atol=1e-6, rtol=1e-5)
    # gsplat adds alternating terms of up to some hundreds in float32
    torch.testing.assert_close(mine[1], theirs[1], atol=0, rtol=2e-3)
    assert torch.equal(copies, relocations()[2]), "gsplat's clamp must not reach ours"


def test_one_copy_is_the_gaussian_itself(parts: Parts):
    opacities, scales, _ = relocations()
    same = parts.relocated(opacities, scales, torch.ones(200, dtype=torch.long))
    torch.testing.assert_close(same[0], opacities, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(same[1], scales, atol=0, rtol=1e-5)


def test_copies_are_as_opaque_together_as_one_was(parts: Parts):
    opacities, scales, copies = relocations()
    new, _ = parts.relocated(opacities, scales, copies)
    torch.testing.assert_close(1 - (1 - new) ** copies, opacities, atol=1e-4, rtol=0)


def test_copies_are_narrower(parts: Parts):
    opacities, scales, copies = relocations()
    _, new = parts.relocated(opacities, scales, copies)
    assert (new[copies > 1] < scales[copies > 1]).all()


def test_copies_of_faint_gaussians_keep_their_size(parts: Parts):
    # To first order in the opacity, n copies of o / n add up to o at any place.
    opacities, scales = torch.full((20,), 0.001), draw(20, 3).exp()
    new, sizes = parts.relocated(opacities, scales, torch.full((20,), 5))
    torch.testing.assert_close(new, opacities / 5, atol=0, rtol=1e-3)
    torch.testing.assert_close(sizes, scales, atol=0, rtol=2e-3)


def test_nearest_agrees(cuda: ModuleType):
    means, sample = draw(500, 3), torch.arange(0, 500, 3)
    mine, theirs = (part.nearest(means, sample, 5) for part in (cpu_parts, cuda))
    assert torch.equal(mine.sort(dim=1).values, theirs.sort(dim=1).values)


def test_nearest_are_the_nearest(parts: Parts):
    means, sample = draw(200, 3), torch.tensor([3, 3, 199, 0])
    found = parts.nearest(means, sample, 4)
    distances = (means[sample][:, None] - means).norm(dim=-1)
    distances[torch.arange(4), sample] = torch.inf
    assert torch.equal(found, distances.argsort(dim=1)[:, :4])


def test_nobody_is_its_own_neighbour(parts: Parts):
    # Copies lie at the same place as what they were copied from.
    means = draw(40, 3)[torch.arange(200) % 40]
    sample = torch.arange(200)
    found = parts.nearest(means, sample, 5)
    assert found.shape == (200, 5)
    assert not (found == sample[:, None]).any()
    assert all(len(set(row)) == 5 for row in found.tolist())


def test_many_distances_are_taken_in_parts(cuda: ModuleType, monkeypatch: pytest.MonkeyPatch):
    means, sample = draw(300, 3), torch.arange(100)
    whole = cuda.nearest(means, sample, 5)
    monkeypatch.setattr(cuda, "DISTANCES_AT_ONCE", 1000)
    assert torch.equal(cuda.nearest(means, sample, 5), whole)


def test_photometric_losses_agree(cuda: ModuleType):
    image, target = draw(30, 41, 3).sigmoid(), draw(30, 41, 3, seed=1).sigmoid()
    mine, theirs = (part.photometric_loss(image, target, 0.2) for part in (cpu_parts, cuda))
    torch.testing.assert_close(mine, theirs, atol=1e-6, rtol=1e-5)


def test_training_takes_the_same_way_on_both(
    cuda: ModuleType, capture: Capture, monkeypatch: pytest.MonkeyPatch
):
    # Noise, which differs sample by sample, left out; growth and neighbours included.
    config = TrainConfig(steps=12, max_gaussians=200, refine_every=5, identity_every=1)
    monkeypatch.setattr(growth, "NOISE_RATE", 0.0)
    mine = fit(capture, config)
    for module in (adam, growth, gradients, losses):
        monkeypatch.setattr(module, "parts_for", lambda device: cuda)
    theirs = fit(capture, config)
    assert mine.ids == theirs.ids
    for name, tensor in mine.params.items():
        assert theirs.params[name].dtype == tensor.dtype
        error = (theirs.params[name] - tensor).detach().norm() / tensor.detach().norm()
        # Rounding, which Adam blows up where gradients hardly differ from 0: those of the
        # rotations of Gaussians that are round still are nothing but rounding. A step without its
        # corrections, say, would be three times as long: 0.1.
        assert error < (2e-2 if name == "quats" else 5e-3), name

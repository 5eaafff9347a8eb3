"""One step: what is compared, and whom the gradients reach."""

from dataclasses import replace

import pytest
import torch

from begun_runs import begun
from stylesplat.scene.capture import Capture
from stylesplat.training import step as stepping
from stylesplat.training.gradients import (
    NEIGHBOR_SAMPLES,
    NEIGHBORS,
    fill_gradients,
    neighbors_of_some,
    rows_of,
)
from stylesplat.training.state import first_state
from stylesplat.training.step import RATES, rates, train_step
from stylesplat.training.train_config import TrainConfig

GEOMETRY = ("means", "quats", "scales", "opacities")


def gradients(capture: Capture, config: TrainConfig, step: int = 0) -> dict[str, torch.Tensor]:
    run, state = begun(capture, config)
    fill_gradients(run, replace(state, step=step), run.generator(step))
    return {name: t.grad for name, t in state.params.items() if t.grad is not None}


@pytest.fixture
def config() -> TrainConfig:
    return TrainConfig(coarse_to_fine=False, identity_every=2)


def test_the_identity_loss_moves_no_geometry_unless_told(capture: Capture, config: TrainConfig):
    plain = gradients(replace(capture, label_maps=None), config)
    joint = gradients(capture, config)
    moving = gradients(capture, replace(config, identity_geometry=True))
    for name in (*GEOMETRY, "sh0"):
        # The same sums in another order.
        assert (joint[name] - plain[name]).norm() < 1e-4 * plain[name].norm(), name
    for name in GEOMETRY:
        if name != "quats":  # of round Gaussians
            assert (moving[name] - plain[name]).norm() > 1e-2 * plain[name].norm(), name


def test_identities_have_gradients_every_few_steps_only(capture: Capture, config: TrainConfig):
    for step in range(5):
        names = gradients(capture, config, step).keys()
        assert ({"identities", "weight", "bias"} <= names) == (step % 2 == 0)
        assert {*GEOMETRY, "sh0", "shN"} <= names


def test_gradients_do_not_add_up_over_steps(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    for _ in range(2):
        fill_gradients(run, state, run.generator(0))
    once = gradients(capture, config)
    for name, gradient in once.items():
        # Threads may add up in another order.
        torch.testing.assert_close(state.params[name].grad, gradient, atol=1e-6, rtol=1e-4)


def test_scores_are_loss_and_psnr(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    _, scores = fill_gradients(run, state, run.generator(0))
    loss, psnr = scores.tolist()
    assert 0.1 < loss < 3 and 3 < psnr < 30 and not scores.requires_grad


def test_seen_are_those_in_the_picture(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    with torch.no_grad():
        state.params["means"][:10] += 100
    seen, _ = fill_gradients(run, state, run.generator(0))
    assert not seen[:10].any() and seen[10:].all()


def test_a_step_leaves_what_nobody_sees(capture: Capture, config: TrainConfig):
    run, state = begun(replace(capture, label_maps=None), config)
    with torch.no_grad():
        state.params["means"][:10] += 100
        state.params["opacities"][:10] = 5.0  # no noise either
    before = state.clone()
    after, _ = train_step(run, state)
    for name in state.names:
        assert torch.equal(after.params[name][:10], before.params[name][:10]), name
        assert not after.moments.first[name][:10].any()
        if name not in ("quats", "shN"):  # of round Gaussians, of bands not in use yet
            assert not torch.equal(after.params[name][10:], before.params[name][10:]), name


def test_a_step_counts(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    after, _ = train_step(run, state)
    assert after.step == 1 and after.seconds == state.seconds


def test_a_step_is_a_function_of_state_and_number(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    one, _ = train_step(run, replace(state.clone(), step=10))
    train_step(run, replace(state.clone(), step=11))
    other, _ = train_step(run, replace(state.clone(), step=10))
    for name, tensor in one.params.items():
        assert torch.equal(tensor, other.params[name]), name


def test_growth_comes_at_the_end_of_its_interval(capture: Capture, config: TrainConfig):
    run, state = begun(capture, replace(config, steps=100, refine_every=10, max_gaussians=200))
    counts = [
        len(train_step(run, replace(state.clone(), step=step))[0].splats)
        for step in (8, 9, 10, 19, 89, 99)
    ]
    first = len(state.splats)
    assert counts[0] == counts[2] == first < counts[1] < counts[3] <= 200
    assert counts[4] == 200 and counts[5] == first, "nothing is added in the last tenth"


def test_sizes_of_objects_are_limited_where_asked(capture: Capture, monkeypatch):
    asked: list[float] = []
    monkeypatch.setattr(stepping, "limit_sizes", lambda splats, cameras, size: asked.append(size))
    for pixels in (None, 2.0):
        config = TrainConfig(refine_every=1, object_pixels=pixels)
        train_step(*begun(capture, config))
    assert asked == [2.0]


def test_every_trained_tensor_has_a_rate(capture: Capture, config: TrainConfig):
    _, state = begun(capture, config)
    assert rates(config, 1.0).keys() == state.params.keys()


def test_only_the_rate_of_means_follows_the_unit(config: TrainConfig):
    one, other = rates(config, 1.0), rates(config, 0.01)
    assert other["means"] == pytest.approx(0.01 * one["means"])
    assert {n: r for n, r in one.items() if n != "means"} == {
        n: r for n, r in other.items() if n != "means"
    }
    assert RATES.items() <= one.items()


def test_neighbours_of_some():
    means = torch.randn(50, 3, generator=torch.Generator().manual_seed(0))
    sample, neighbors = neighbors_of_some(means, torch.Generator().manual_seed(1))
    assert sample.shape == (50,) and neighbors.shape == (50, NEIGHBORS)
    assert 0 <= int(sample.min()) and int(sample.max()) < 50
    again, _ = neighbors_of_some(means, torch.Generator().manual_seed(1))
    assert torch.equal(sample, again)


def test_fewer_gaussians_than_neighbours_still_train(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config)
    few = first_state(state.splats.detach()[torch.arange(NEIGHBORS)])
    after, scores = train_step(run, few)
    assert scores.isfinite().all() and len(after.splats) == NEIGHBORS


def test_gradients_of_rows_are_added_up_in_order():
    """Enough of them that torch would share the work, and each many times."""
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(50, 16, generator=generator).requires_grad_()
    rows = torch.randint(len(table), (NEIGHBOR_SAMPLES, NEIGHBORS), generator=generator)
    v_found = torch.randn(*rows.shape, 16, generator=generator)
    assert torch.equal(rows_of(table, rows), table[rows])

    def gradient() -> torch.Tensor:
        return torch.autograd.grad(rows_of(table, rows), table, v_found)[0]

    first, threads = gradient(), torch.get_num_threads()
    try:
        torch.set_num_threads(max(2, threads))
        assert all(torch.equal(gradient(), first) for _ in range(50))
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize("cut_out", [False, True])
def test_photos_without_anything_of_their_own_teach_the_same(
    capture: Capture, config: TrainConfig, cut_out: bool
):
    assert capture.label_maps is not None
    covered = [255 * (x > 0).to(torch.uint8) for x in capture.label_maps if x is not None]
    photos = [photo.clamp(max=200) for photo in capture.photos]  # nothing is blown out
    alphas = covered if cut_out else None
    run, state = begun(replace(capture, photos=photos, label_maps=None, alphas=alphas), config)
    zeros = {"color_maps": torch.zeros(9, 3, 4), "pose_shifts": torch.zeros(9, 6)}
    learning = state.clone().with_photos(zeros)
    scores = [fill_gradients(run, each, run.generator(0)).scores for each in (state, learning)]
    assert torch.allclose(*scores, rtol=1e-5)
    for name, param in state.params.items():
        other = learning.params[name].grad
        assert param.grad is not None and other is not None
        # Colours are put over the background in another order
        assert (other - param.grad).norm() <= 1e-3 * param.grad.norm(), name
    for name in zeros:
        own = learning.params[name].grad
        assert own is not None and own[run.row(0)].any()
        assert int(own.flatten(1).any(dim=1).sum()) == 1

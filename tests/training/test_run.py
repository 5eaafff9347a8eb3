import torch

from scenes import random_splats
from stylesplat.training.initialize import scene_extent
from stylesplat.training.run import Run
from stylesplat.training.state import State, first_state
from stylesplat.training.train_config import TrainConfig


def run(cameras, *, rows=tuple(range(1, 9)), **settings) -> Run:
    return Run(
        config=TrainConfig(**settings),
        rows=rows,
        views=lambda row, factor: None,  # pyright: ignore[reportArgumentType]
        cameras=cameras,
        extent=scene_extent(cameras),
        device=torch.device("cpu"),
    )


def state(step: int = 0, seconds: float = 0.0) -> State:
    begun = first_state(random_splats(5))
    return State(begun.params, begun.moments, (), 5, step, seconds)


def test_each_photo_comes_once_per_epoch(cameras):
    here = run(cameras)
    for epoch in range(5):
        rows = [here.row(8 * epoch + place) for place in range(8)]
        assert sorted(rows) == list(range(1, 9))


def test_epochs_and_seeds_have_their_own_order(cameras):
    orders = {
        tuple(run(cameras, seed=seed).row(8 * epoch + place) for place in range(8))
        for seed in range(4)
        for epoch in range(4)
    }
    assert len(orders) == 16


def test_the_order_is_a_function_of_the_step(cameras):
    forth = [run(cameras).row(step) for step in range(24)]
    back = [run(cameras).row(step) for step in reversed(range(24))]
    assert forth == back[::-1]


def test_every_photo_may_come_first(cameras):
    firsts = {run(cameras, seed=seed).row(0) for seed in range(60)}
    assert firsts == set(range(1, 9))  # each is missed with a chance of (7/8)^60, 3 in 10,000


def test_random_numbers_follow_from_seed_and_step(cameras):
    def numbers(seed: int, step: int) -> tuple[float, ...]:
        return tuple(torch.randn(4, generator=run(cameras, seed=seed).generator(step)).tolist())

    assert numbers(1, 5) == numbers(1, 5)
    assert len({numbers(seed, step) for seed in range(5) for step in range(5)}) == 25


def test_random_numbers_of_neighbouring_steps_are_independent(cameras):
    here = run(cameras)
    drawn = torch.stack([torch.randn(1000, generator=here.generator(s)) for s in range(20)])
    correlation = torch.corrcoef(drawn) - torch.eye(20)
    assert correlation.abs().max() < 0.16  # five standard deviations of 1 / sqrt(1000)
    assert drawn[:, 0].std() > 0.5, "the first number differs too"


def test_offsets_cover_the_stride(cameras):
    here = run(cameras, identity_stride=3)
    offsets = [here.offset(step) for step in range(100)]
    assert set(offsets) == {(y, x) for y in range(3) for x in range(3)}
    assert offsets[7] == here.offset(7)


def test_without_a_stride_there_is_no_offset(cameras):
    assert {run(cameras, identity_stride=1).offset(step) for step in range(9)} == {(0, 0)}


def test_progress_is_the_share_of_steps(cameras):
    here = run(cameras, steps=200)
    shares = [here.progress(state(step)) for step in (0, 50, 200, 300)]
    assert shares == [0, 0.25, 1, 1]


def test_progress_is_the_share_of_seconds_if_these_are_given(cameras):
    here = run(cameras, steps=10, max_seconds=4.0)
    shares = [here.progress(state(1000, seconds)) for seconds in (0.0, 1.0, 4.0, 5.0)]
    assert shares == [0, 0.25, 1, 1]

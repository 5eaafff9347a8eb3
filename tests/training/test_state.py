from dataclasses import replace

import torch

from scenes import random_splats
from stylesplat.training.initialize import scene_extent
from stylesplat.training.state import Run, first_state
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


def test_each_photo_comes_once_per_epoch_in_an_order_that_follows_from_the_step(cameras):
    here = run(cameras)
    for epoch in range(5):
        rows = [here.row(8 * epoch + place) for place in range(8)]
        assert sorted(rows) == list(range(1, 9))
    forth = [run(cameras).row(step) for step in range(24)]
    back = [run(cameras).row(step) for step in reversed(range(24))]
    assert forth == back[::-1]
    firsts = {run(cameras, seed=seed).row(0) for seed in range(60)}
    assert firsts == set(range(1, 9))  # each is missed with a chance of (7/8)^60, 3 in 10,000
    seeds = {run(cameras, seed=s).generator(n).initial_seed() for s in range(5) for n in range(5)}
    assert len(seeds) == 25


def test_offsets_cover_the_stride(cameras):
    here = run(cameras, identity_stride=3)
    offsets = [here.offset(step) for step in range(100)]
    assert set(offsets) == {(y, x) for y in range(3) for x in range(3)}
    assert offsets[7] == here.offset(7)


def test_a_round_takes_the_next_steps(cameras):
    here, state = replace(run(cameras, steps=11), batch=4), first_state(random_splats(5))

    def rounds(here: Run) -> list[list[int]]:
        return [[*here.photos(replace(state, step=step))] for step in (0, 4, 8)]

    assert rounds(here) == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    timed = replace(here, config=replace(here.config, max_seconds=9.0))
    assert rounds(timed)[-1] == [8, 9, 10, 11]
    shares = [timed.progress(replace(state, step=1000, seconds=s)) for s in (0.0, 4.5, 9.0, 10.0)]
    assert shares == [0, 0.5, 1, 1]
    assert [here.every(2, step) for step in range(12)] == [True] * 4 + [False] * 4 + [True] * 4

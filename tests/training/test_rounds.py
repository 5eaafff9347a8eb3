"""Several photos looked at together."""

from collections.abc import Iterator
from dataclasses import replace

import numba
import pytest
import torch

from begun_runs import begun
from stylesplat.rendering.at_once import Crew
from stylesplat.scene.capture import Capture
from stylesplat.training.run import Run
from stylesplat.training.state import State
from stylesplat.training.step import _look, _take_steps, train_step
from stylesplat.training.train_config import TrainConfig


@pytest.fixture
def one_thread() -> Iterator[int]:
    """As each of two threads has it that share two cores; yields how many there are else."""
    before = numba.get_num_threads(), torch.get_num_threads()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    yield before[0]
    numba.set_num_threads(before[0])
    torch.set_num_threads(before[1])


def after(run: Run, state: State, rounds: int) -> State:
    state = state.clone()
    for _ in range(rounds):
        state, _ = train_step(run, state)
    return state


def same(one: State, other: State) -> bool:
    pairs = zip(one.params.values(), other.params.values(), strict=True)
    return one.step == other.step and all(torch.equal(a, b) for a, b in pairs)


def test_every_step_is_of_one_round(capture: Capture, config: TrainConfig):
    run, state = begun(capture, replace(config, steps=11), 4, of_photos=True)
    found = [[*run.photos(replace(state, step=step))] for step in (0, 4, 8)]
    assert found == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    timed = replace(run, config=replace(run.config, max_seconds=9.0))
    assert [*timed.photos(replace(state, step=8))] == [8, 9, 10, 11]


def test_all_of_a_round_learn_identities_or_none(capture: Capture, config: TrainConfig):
    run, _ = begun(capture, config, 3, of_photos=True)
    found = [run.every(2, step) for step in range(9)]
    assert found == [True] * 3 + [False] * 3 + [True] * 3


def test_threads_change_nothing(capture: Capture, config: TrainConfig, one_thread: int):
    config = replace(config, refine_poses=True, color_correction="on")
    run, state = begun(capture, config, 4, of_photos=True)
    alone = after(run, state, 3)
    numba.set_num_threads(min(one_thread, 2))
    crew = Crew(4)
    try:
        assert crew.size == numba.get_num_threads()
        assert same(after(replace(run, crew=crew), state, 3), alone)
    finally:
        crew.end()
    assert alone.step == 12


def test_looks_are_of_one_moment_and_steps_in_turn(capture: Capture, config: TrainConfig):
    run, state = begun(capture, config, 2, of_photos=True)
    together, one, other = after(run, state, 1), state.clone(), state.clone()
    looks = [_look(run, one, step) for step in (0, 1)]
    calm = [look._replace(noise=torch.zeros_like(look.noise)) for look in looks]
    _take_steps(run, calm)
    for look in [_look(run, other, step) for step in (0, 1)]:
        still = look._replace(noise=torch.zeros_like(look.noise))
        _take_steps(run, [still])
    assert same(one, other)
    for name, each in one.params.items():
        assert torch.equal(each, together.params[name]) == (name != "means"), name
    assert not same(after(replace(run, batch=1), state, 2), together)


def test_growth_within_a_round(capture: Capture, config: TrainConfig):
    config = replace(config, steps=100, refine_every=10, max_gaussians=200)
    run, state = begun(capture, config, 4, of_photos=True)
    counts = [len(train_step(run, replace(state.clone(), step=step))[0].splats) for step in (4, 8)]
    assert counts[0] == len(state.splats) < counts[1]

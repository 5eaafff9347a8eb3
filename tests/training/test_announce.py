from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
import torch

from scenes import random_splats
from stylesplat.progress import Silence, observed
from stylesplat.training import announce
from stylesplat.training.announce import GPU_STEPS, Tally, announced
from stylesplat.training.state import State, first_state
from stylesplat.training.train_config import TrainConfig

GPU = torch.device("cuda")
STATE = first_state(random_splats(1500))


class Listener(Silence):
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.begun: tuple = ()
        self.done = 0.0
        self.notes: list[str] = []

    @contextmanager
    def task(self, what: str, total, unit: str, done) -> Iterator["Listener"]:
        self.begun, self.done = (what, total, unit), done
        yield self

    def advance(self, amount: float = 1) -> None:
        self.done += amount

    def note(self, text: str) -> None:
        self.notes.append(text)


def at(step: int, seconds: float = 0.0) -> State:
    return replace(STATE, step=step, seconds=seconds)


@pytest.fixture
def listener() -> Iterator[Listener]:
    here = Listener()
    with observed(here):
        yield here


def test_steps_are_counted(listener: Listener):
    with announced(TrainConfig(steps=50), at(0)) as report:
        for step in (10, 20, 27):
            report(at(step), 0.5, 20.0)
            assert listener.done == step
    assert listener.begun == ("training", 50, "step")


def test_seconds_are_counted_where_they_end_the_run(listener: Listener):
    with announced(TrainConfig(max_seconds=5.0), at(0)) as report:
        report(at(10, 2.5), 0.5, 20.0)
        assert listener.done == 2.5
        report(at(20, 5.7), 0.5, 20.0)
        assert listener.done == 5.0, "not beyond the end"
    assert listener.begun == ("training", 5.0, "s")


def test_what_an_earlier_run_did_counts(listener: Listener):
    with announced(TrainConfig(steps=50), at(30)) as report:
        assert listener.done == 30
        report(at(40), 0.5, 20.0)
    assert listener.done == 40


def test_notes_hold_loss_psnr_and_gaussians(listener: Listener):
    with announced(TrainConfig(), at(0)) as report:
        report(at(1), 0.5, 20.0)
    assert listener.notes == ["loss 0.5000, PSNR 20.00 dB, 1,500 Gaussians"]


def test_what_is_told_is_smooth_and_gets_there(listener: Listener):
    with announced(TrainConfig(steps=9000), at(0)) as report:
        report(at(10), 1.0, 10.0)
        report(at(20), 0.0, 30.0)
        report(at(2000), 0.0, 30.0)
    losses = [float(note.split(",")[0].removeprefix("loss ")) for note in listener.notes]
    assert losses[0] == 1 > losses[1] > 0.5 and losses[2] == 0


def test_others_are_told_too(listener: Listener):
    heard: list[tuple] = []
    with announced(TrainConfig(), at(0), lambda *told: heard.append(told)) as report:
        report(at(3), 0.5, 20.0)
    assert [(state.step, loss, psnr) for state, loss, psnr in heard] == [(3, 0.5, 20.0)]


def test_a_tally_averages():
    tally = Tally()
    for loss in (1.0, 2.0, 6.0):
        tally = tally.plus(torch.tensor([loss, 10 * loss]))
    assert tally.means() == (3.0, 30.0) and tally.steps == 3


def test_a_gpu_is_waited_for_every_few_steps():
    told = [step for step in range(1, 31) if Tally().due(step, GPU)]
    assert told == [GPU_STEPS * i for i in range(1, 30 // GPU_STEPS + 1)]


def test_on_a_cpu_there_is_nothing_to_wait_for():
    assert all(Tally().due(step, torch.device("cpu")) for step in range(1, 31))


def test_slow_steps_are_told_one_by_one(monkeypatch: pytest.MonkeyPatch):
    tally, now = Tally(), announce.monotonic()
    monkeypatch.setattr(announce, "monotonic", lambda: now + 1.5)
    assert tally.due(3, GPU)

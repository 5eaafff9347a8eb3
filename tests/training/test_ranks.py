"""Processes that train together: here threads that add up, and once the command itself."""

import json
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Barrier

import pytest
import torch
from torch import Tensor

from capture_files import write_ball_capture
from processes import begun
from stylesplat.rendering.kernels.jit import SHARED
from stylesplat.scene.capture import Capture
from stylesplat.training.state import Ranks, Run, State
from stylesplat.training.step import (
    PhotoGradients,
    average_gradients,
    compute_gradients,
    train_step,
)
from stylesplat.training.train_config import TrainConfig

together = pytest.mark.skipif(not SHARED, reason="numba has no OpenMP: one thread at a time")


@dataclass
class Meeting:
    """What threads share that play processes."""

    count: int
    tensors: dict[int, list[Tensor]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.barrier = Barrier(self.count, timeout=60)


@dataclass(frozen=True)
class Threads(Ranks):
    """Threads instead of processes."""

    meeting: Meeting = field(default_factory=lambda: Meeting(1))

    def add_up(self, tensors: Iterable[Tensor]) -> None:
        """As torch.distributed does."""
        own = [*tensors]
        self.meeting.tensors[self.number] = [each.clone() for each in own]
        self.meeting.barrier.wait()
        everybody = [self.meeting.tensors[number] for number in range(self.count)]
        self.meeting.barrier.wait()
        for each, *others in zip(own, *everybody, strict=True):
            each.copy_(sum(others[1:], others[0]))


def runs(capture: Capture, config: TrainConfig, count: int, batch: int) -> list[tuple[Run, State]]:
    meeting = Meeting(count)
    run, state = begun(capture, config, batch, of_photos=True)
    ranks = [Threads(number, count, meeting) for number in range(count)]
    return [(replace(run, ranks=each), state.clone()) for each in ranks]


def at_a_time(function, processes: list[tuple[Run, State]]) -> list:
    with ThreadPoolExecutor(len(processes)) as pool:
        return [*pool.map(lambda process: function(*process), processes)]


@together
@pytest.mark.parametrize("batch", [1, 2])
def test_gradients_are_the_mean_of_single_ones(capture: Capture, config: TrainConfig, batch: int):
    config, photos = replace(config, refine_poses=True), 3 * batch

    def averaged(run: Run, state: State) -> PhotoGradients:
        return average_gradients(
            run, [compute_gradients(run, state, step) for step in run.photos(state)]
        )

    rounds = at_a_time(averaged, runs(capture, config, 3, batch))
    assert all((each.photos, each.state.step) == (photos, 0) for each in rounds)
    (run, state), single = runs(capture, config, 1, 1)[0], []
    for step in range(photos):
        single.append(compute_gradients(replace(run, batch=photos), state, step).state)
    for name in ("means", "quats", "scales", "opacities", "sh0", "identities", "weight"):
        found = [each.state.params[name].grad for each in rounds]
        expected = torch.stack([each.params[name].grad for each in single]).sum(dim=0)
        assert all(torch.equal(each, found[0]) for each in found), name
        assert (photos * found[0] - expected).norm() <= 1e-6 * expected.norm(), name
    rows = rounds[0].state.params["pose_shifts"].grad
    for step, each in enumerate(single):
        assert torch.equal(rows[run.row(step)], each.params["pose_shifts"].grad[run.row(step)])


@together
def test_all_stay_the_same(capture: Capture, config: TrainConfig):
    config = replace(config, steps=44, refine_every=10, max_gaussians=150, color_correction="on")

    def train(run: Run, state: State) -> State:
        while state.step < config.steps:
            state, _ = train_step(run, state)
        return state

    processes = runs(capture, config, 2, 2)
    run = processes[0][0]
    after, _ = at_a_time(train_step, [(run, state.clone()) for run, state in processes])[0]
    assert after.step == 4, "all photos of a round have one step"
    stepped = after.moments.second["color_maps"].flatten(1).any(dim=1).nonzero()[:, 0]
    assert {*stepped.tolist()} == {run.rows.index(run.row(step)) for step in range(4)}
    one, other = at_a_time(train, processes)
    assert one.step == other.step == 44 and len(one.splats) > 100
    for name, tensor in one.params.items():
        assert torch.equal(tensor, other.params[name]), name
        assert torch.equal(one.moments.second[name], other.moments.second[name]), name


def test_the_command(tmp_path: Path):
    photos = write_ball_capture(tmp_path / "balls")
    command = [
        *(sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"),
        *("-m", "stylesplat", "train", str(photos), "-o", str(tmp_path / "scene")),
        *("--steps", "20", "--max-gaussians", "300", "--device", "cpu", "--json"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == 20, "one process answers"
    assert (tmp_path / "scene" / "splats.ply").exists()
    assert [each.name for each in tmp_path.iterdir() if "partial" in each.name] == []

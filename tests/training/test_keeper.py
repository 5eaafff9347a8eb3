"""Checkpoints that cannot be written cost a line, and nothing else."""

import os
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from scenes import random_splats
from small_files import no_room
from stylesplat.errors import StyleSplatError
from stylesplat.scene.capture import Capture
from stylesplat.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from stylesplat.training.keeper import Keeper
from stylesplat.training.loop import fit
from stylesplat.training.state import State, first_state
from stylesplat.training.train_config import TrainConfig

CPU = torch.device("cpu")
MARK = "names=1 size=2 poses=3 points=4 labels=5 objects=6 photos=7"


def state(step: int = 4) -> State:
    return replace(first_state(replace(random_splats(20), identities=None)), step=step)


@pytest.fixture
def place(tmp_path: Path) -> Checkpoint:
    return Checkpoint(tmp_path / "checkpoint.pt", TrainConfig(steps=9), MARK)


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint after each step."""
    monkeypatch.setattr("stylesplat.training.keeper.CHECKPOINT_SECONDS", -1.0)


def test_a_checkpoint_that_has_no_room_leaves_the_last_one(place: Checkpoint):
    save_checkpoint(place, state())
    with no_room(), pytest.raises(StyleSplatError, match=r"Cannot write .*: File too large\."):
        save_checkpoint(place, state(step=5))
    assert [*place.path.parent.iterdir()] == [place.path]
    assert load_checkpoint(place, CPU).step == 4


def test_a_full_disk_is_called_so(tmp_path: Path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk]
    if os.getuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("cannot mount a small disk here")
    place = Checkpoint(disk / "checkpoint.pt", TrainConfig(), MARK)
    try:
        save_checkpoint(place, state())
        (disk / "other").write_bytes(bytes(disk_left(disk)))
        with pytest.raises(StyleSplatError, match="disk full"):
            save_checkpoint(place, state(step=5))
        assert load_checkpoint(place, CPU).step == 4
    finally:
        subprocess.run(["umount", disk], check=True)


def disk_left(disk: Path) -> int:
    room = os.statvfs(disk)
    return room.f_bavail * room.f_frsize


def test_torch_without_a_reason(place: Checkpoint, monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> None:
        raise RuntimeError("[enforce fail at inline_container.cc:671] . unexpected pos 1\nframe")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(StyleSplatError, match=r"Cannot write .*unexpected pos 1\.$"):
        save_checkpoint(place, state())


def test_said_once_and_when_it_works_again(place: Checkpoint, said: list[str], often: None):
    keeper = Keeper(place, state())
    with no_room():
        keeper.after_step(state())
        keeper.after_step(state())
    (line,) = said
    assert "File too large" in line and line.endswith("The training goes on all the same.")
    keeper.after_step(state())
    keeper.after_step(state())
    assert said[1:] == ["Checkpoints can be written again."]


def test_the_run_goes_on_without_and_has_its_result(
    capture: Capture, config: TrainConfig, tmp_path: Path, said: list[str], often: None
):
    checkpoint = tmp_path / "checkpoint.pt"
    with no_room():
        found = fit(capture, config, checkpoint=checkpoint)
    assert found.step == config.steps
    assert sum(line.startswith("Cannot write") for line in said) == 1
    assert not checkpoint.exists()


def test_an_interrupted_run_that_is_not_kept_says_so(
    capture: Capture, config: TrainConfig, tmp_path: Path, said: list[str]
):
    config, checkpoint = replace(config, photos_at_once=1), tmp_path / "checkpoint.pt"

    def stop_at(step: int):
        def stop(state: State, loss: float, psnr: float) -> None:
            if state.step == step:
                signal.raise_signal(signal.SIGINT)

        return stop

    with no_room(), pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop_at(2))
    assert said[-1].endswith("There is no checkpoint, and the run was at step 2.")
    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop_at(3))
    with no_room(), pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop_at(5))
    assert said[-1].endswith("The last checkpoint is of step 3, and the run was at step 5.")

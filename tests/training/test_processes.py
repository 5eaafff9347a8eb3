"""Processes that train together: two that talk by gloo, in place of GPUs that talk by NCCL."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import torch.distributed as dist
from torch import Tensor
from torch.multiprocessing.spawn import spawn

from capture_files import write_ball_capture
from processes import begun, complaint
from stylesplat.errors import StyleSplatError
from stylesplat.scene.capture import Capture
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit, rank_and_processes, stop_together
from stylesplat.training.state import PhotoGradients
from stylesplat.training.step import exchange_gradients, photo_gradients, train_step

COUNT = 2
CONFIG = TrainConfig(
    steps=24,
    max_gaussians=150,
    refine_every=10,
    color_correction="on",
    refine_poses=True,
)


def gradients_of(photo: PhotoGradients) -> dict[str, Tensor]:
    return {name: t.grad for name, t in photo.state.params.items() if t.grad is not None}


def join(rank: int, folder: Path, capture: Capture) -> None:
    """What each process does: compare, average, train, and save what it has found."""
    torch.set_num_threads(1)
    dist.init_process_group("gloo", f"file://{folder}/meeting", rank=rank, world_size=COUNT)
    assert rank_and_processes() == (rank, COUNT)
    run, state = begun(capture, CONFIG, COUNT, of_photos=True)
    run = replace(run, rank=rank, processes=COUNT, exchange=exchange_gradients)
    (mean,) = run.exchange([photo_gradients(run, state, step) for step in run.own_steps(state)])
    assert (mean.photos, mean.state.step) == (COUNT, 0)
    gradients = gradients_of(mean)
    first, _ = train_step(run, state.clone())
    after = state.clone()
    while after.step < CONFIG.steps:
        after, _ = train_step(run, after)
    later, stopped = stop_together(run, replace(after, seconds=float(rank)), stopped=rank == 0)
    assert (later.seconds, stopped) == (COUNT - 1, True)
    with pytest.raises(StyleSplatError, match="3 photos at once by 2 processes"):
        fit(capture, replace(CONFIG, photos_at_once=3))
    stepped = [first.step, first.moments.second["color_maps"]]
    found = gradients, stepped, after.step, after.params, after.moments.second
    torch.save(found, folder / f"{rank}.pt")
    dist.destroy_process_group()


@pytest.mark.usefixtures("all_cores")  # as each of the processes has them
def test_gradients_are_means_and_all_processes_stay_alike(capture: Capture, tmp_path: Path):
    spawn(join, (tmp_path, capture), COUNT)
    one, other = (torch.load(tmp_path / f"{rank}.pt") for rank in range(COUNT))
    gradients, (step, moments), steps, params, second = one
    run, state = begun(capture, CONFIG, COUNT, of_photos=True)
    photos = [gradients_of(photo_gradients(run, state, step)) for step in range(COUNT)]
    for name in ("means", "quats", "scales", "opacities", "sh0", "identities", "weight"):
        expected = torch.stack([each[name] for each in photos]).mean(dim=0)
        assert torch.equal(gradients[name], other[0][name]), name
        assert (gradients[name] - expected).norm() <= 1e-6 * expected.norm(), name
    for step_of_photo, each in enumerate(photos):
        row = run.row(step_of_photo)
        assert torch.equal(gradients["pose_shifts"][row], each["pose_shifts"][row])
    assert step == COUNT, "all photos of a round have one step"
    stepped = moments.flatten(1).any(dim=1).nonzero()[:, 0]
    assert {*stepped.tolist()} == {run.rows.index(run.row(step)) for step in range(COUNT)}
    assert steps == other[2] == CONFIG.steps and len(params["means"]) > 100
    for name, tensor in params.items():
        assert torch.equal(tensor, other[3][name]), name
        assert torch.equal(second[name], other[4][name]), name


def test_the_command_refuses_to_share_out_a_cpu(tmp_path: Path, monkeypatch, capsys):
    """As one of two processes that torchrun has started, which sets these variables."""
    for name in ("TORCHELASTIC_RUN_ID", "RANK", "LOCAL_RANK"):
        monkeypatch.setenv(name, "0")
    for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"):
        monkeypatch.setenv(name, "2")
    photos, out = write_ball_capture(tmp_path / "balls"), tmp_path / "scene"
    line = complaint(capsys, "train", photos, "-o", out, "--steps", 20, "--device", "cpu")
    assert "Cannot train by 2 processes on the CPU" in line and not out.exists()

"""The command line in this process, other processes and users, limits, job files."""

import json
import os
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import dedent

import pytest
import torch

from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_file import plan_batch
from stylesplat.batch_jobs.job_process import JobRecord, RunJob, ended_job
from stylesplat.cli import main
from stylesplat.cli.batch import batch_verbs
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.initialize import first_splats
from stylesplat.training.loop import fit
from stylesplat.training.per_photo import initial_photo_params
from stylesplat.training.state import Run, State, first_state
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import TrainingViews

QUICK = ("--features", "compact", "--quality", "draft", "--device", "cpu")


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def result(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    """What a call that succeeds prints as JSON."""
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that a call says whose input is at fault."""
    assert run(*arguments) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("stylesplat: ")
    assert not any("Traceback" in line for line in lines)
    return lines[-1]


# Waits for what other processes do, each with a limit.

LIMIT = 120.0  # seconds: machines that build this are slow at times


def wait_until(
    reached: Callable[[], object],
    process: subprocess.Popen,
    said: Callable[[], object] = lambda: "",
) -> None:
    """Wait for a process to come that far; if it ends or takes too long, that fails and ends it."""
    last = time.monotonic() + LIMIT
    try:
        while not reached():
            assert process.poll() is None, f"it ended before: {said()}"
            assert time.monotonic() < last, f"it takes too long: {said()}"
            time.sleep(0.02)
    except BaseException:
        process.kill()
        process.wait(timeout=60)
        raise


# What a user meets who may not write everywhere: tests may run as root, who may.

NOBODY = 65534


@contextmanager
def public_folder() -> Iterator[Path]:
    """A folder that everybody may read, unlike pytest's own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        folder.chmod(0o755)
        yield folder


@contextmanager
def as_nobody() -> Iterator[None]:
    """Within the block the process has no rights but those of everybody."""
    user, group = os.getuid(), os.getgid()
    os.setresgid(NOBODY, NOBODY, group)
    os.setresuid(NOBODY, NOBODY, user)
    try:
        yield
    finally:
        os.setresuid(user, user, user)
        os.setresgid(group, group, group)


# What a full disk is like, without one.

NO_ROOM = 4096  # bytes that a file may have


@contextmanager
def no_room(bytes_a_file: int = NO_ROOM) -> Iterator[None]:
    """Within the block files cannot grow larger, neither ours nor those of processes we start."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_a_file, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# Runs of training before their first step.

CPU = torch.device("cpu")


def begun(
    capture: Capture,
    config: TrainConfig,
    batch: int = 1,
    *,
    of_photos: bool = False,
    device: torch.device = CPU,
) -> tuple[Run, State]:
    """On all photos, from a hundred Gaussians; with what is learned of photos, if it is wanted."""
    ids = (0, 3, 7) if capture.label_maps is not None else ()
    rows = range(len(capture))
    run = Run(
        config=config,
        rows=tuple(rows),
        views=TrainingViews(capture, rows, ids=ids, device=device, max_memory=1.0),
        cameras=capture.cameras,
        extent=scene_extent(capture.cameras),
        device=device,
        strategy=MCMCStrategy(config, scene_extent(capture.cameras)),
        batch=batch,
    )
    splats = first_splats(
        capture,
        sh_degree=3,
        max_gaussians=100,
        generator=torch.Generator().manual_seed(0),
        ids=ids,
    )
    state = first_state(splats.to(device))
    return run, state.with_photos(initial_photo_params(run, capture.points)) if of_photos else state


def interrupt(capture: Capture, config: TrainConfig, checkpoint: Path, step: int) -> None:
    """Train to a step, then press Ctrl-C."""

    def stop(state: State, loss: float, psnr: float) -> None:
        if state.step >= step:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        fit(capture, config, checkpoint=checkpoint, on_progress=stop)


# Job files, and what only pretends to run jobs.

VERBS = batch_verbs()


def write_jobs(folder: Path, text: str) -> Path:
    """A job file beside two scenes and pictures that only have their names."""
    parts = [
        f"{name}/{part}" for name in ("garden", "desk") for part in ("scene.json", "splats.ply")
    ]
    for name in (*parts, "wave.jpg", "night.jpg", "other/wave.jpg", "wave.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        if not (folder / name).exists():
            (folder / name).write_text(name)
    path = folder / "jobs.yaml"
    path.write_text(dedent(text))
    return path


def planned(folder: Path, text: str) -> dict[str, Job]:
    """The jobs of a file, by name."""
    return {job.name: job for job in plan_batch(write_jobs(folder, text), VERBS)}


def pretend(begun: list[str], fails: Callable[[str], bool]) -> RunJob:
    """What runs jobs that end at once; `begun` gets their names."""

    def run(job: Job) -> JobRecord:
        begun.append(job.name)
        return ended_job(job, "failed" if fails(job.name) else "done", "")

    return run

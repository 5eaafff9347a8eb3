"""The command line in this process, other processes and users, limits, job files."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
import torch

from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_file import plan_batch
from stylesplat.batch_jobs.job_process import JobRecord, RunJob, ended_job
from stylesplat.cli import main
from stylesplat.cli.batch import batch_verbs
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.config import TrainConfig
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.initialize import first_splats
from stylesplat.training.loop import fit
from stylesplat.training.per_photo import initial_photo_params
from stylesplat.training.state import State, TrainingRun, first_state
from stylesplat.training.views import TrainingViews

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

LIMIT = 240.0  # seconds: machines are slow at times, and whoever comes first compiles kernels


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


def is_running(pid: int) -> bool:
    """Whether a process has not ended (Linux). Some containers bury no orphans."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


# What a user meets who may not write everywhere: tests may run as root, who may.

needs_permissions = pytest.mark.skipif(
    sys.platform == "win32" or (sys.platform != "linux" and os.geteuid() == 0),
    reason="folders can be read-only for users of Linux and macOS, and for root of Linux alone",
)


@contextmanager
def read_only(*folders: Path) -> Iterator[None]:
    """Within the block this thread, and those that it starts, cannot write to these folders."""
    modes = {folder: folder.stat().st_mode for folder in folders}
    for folder in folders:
        folder.chmod(0o555)
    try:
        with _bound_by_permissions() if os.geteuid() == 0 else nullcontext():
            yield
    finally:
        for folder, mode in modes.items():
            folder.chmod(mode)


# As linux/capability.h, linux/prctl.h and linux/securebits.h name them
CAPABILITY_VERSION_3 = 0x20080522
CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 1 << 1, 1 << 2
PR_GET_SECUREBITS, PR_SET_SECUREBITS = 27, 28
NO_SETUID_FIXUP = 1 << 2  # without it `os.access` answers for all that root may take


@contextmanager
def _bound_by_permissions() -> Iterator[None]:
    """Within the block permissions of files count for root, too.

    Root can still read what it owns, such as modules that are imported late.
    """
    libc = ctypes.CDLL(None, use_errno=True)

    def call(function: str, *arguments: Any) -> int:
        done = getattr(libc, function)(*arguments)
        if done < 0:
            pytest.skip(f"root cannot give its rights up: {os.strerror(ctypes.get_errno())}")
        return done

    thread = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION_3, 0)  # this one
    rights = (ctypes.c_uint32 * 6)()  # the lower bits in effect come first
    call("capget", thread, rights)
    before, bits = rights[0], call("prctl", PR_GET_SECUREBITS, 0, 0, 0, 0)
    rights[0] = before & ~(CAP_DAC_OVERRIDE | CAP_DAC_READ_SEARCH)
    call("prctl", PR_SET_SECUREBITS, bits | NO_SETUID_FIXUP, 0, 0, 0)
    call("capset", thread, rights)
    try:
        yield
    finally:
        rights[0] = before
        call("capset", thread, rights)
        call("prctl", PR_SET_SECUREBITS, bits, 0, 0, 0)


# What other systems than Windows have.

needs_pipes = pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="needs pipes and devices that are files"
)

# What a full disk is like, without one.

NO_ROOM = 4096  # bytes that a file may have


@contextmanager
def no_room(bytes_a_file: int = NO_ROOM) -> Iterator[None]:
    """Within the block files cannot grow larger, neither ours nor those of processes we start."""
    resource = pytest.importorskip("resource", reason="needs limits of processes")
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
) -> tuple[TrainingRun, State]:
    """On all photos, from a hundred Gaussians; with what is learned of photos, if it is wanted."""
    ids = (0, 3, 7) if capture.label_maps is not None else ()
    rows = range(len(capture))
    run = TrainingRun(
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

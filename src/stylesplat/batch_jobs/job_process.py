"""Runs a job as a process of the command line, so that a crash costs one job only."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import Event
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from stylesplat.batch_jobs.job import Job
from stylesplat.errors import printable
from stylesplat.io.atomic import PARTIAL

LOGS = "logs"  # in the batch's folder: what each job has printed
WORKER_PATIENCE = 60.0  # seconds for a process to save what it has after SIGTERM
PAUSE = 0.05  # seconds between two looks at a process
THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
FAULT = re.compile(r"stylesplat(?: \w+)?: (.+)")  # the last line of a verb that fails
KILLED = (
    "it was killed, perhaps because memory ran out. Use fewer workers, or with Ray "
    "`needs: {memory: GB}`."
)
BRIEF = 300  # characters of the last line of a process, where no verb has written it
# Becomes a command that gets SIGTERM when its parent dies, which Linux offers as prctl(1, 15).
# subprocess could call it between fork and exec, but that is not safe beside threads
END_WITH_PARENT = """
import ctypes, os, sys
ctypes.CDLL(None).prctl(1, 15)
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""
Status = Literal["done", "failed", "skipped"]


class JobRecord(msgspec.Struct, frozen=True, kw_only=True):
    """How a job ended: a line of `jobs.jsonl`."""

    job: str
    """Its name, and that of its folder."""
    verb: str
    status: Status
    fingerprint: str = ""
    """A digest of what it was made from."""
    command: tuple[str, ...] = ()
    """The command line after `stylesplat`."""
    seconds: float = 0.0
    threads: int = 0
    memory_gb: float | None = None
    """Peak memory, where the system tells it."""
    node: str = ""
    """Where it ran, with Ray."""
    ended: str = ""
    """UTC."""
    reason: str = ""
    """Why it is not done, in a line."""
    result: dict[str, Any] = {}
    """What the verb printed with `--json`."""

    @property
    def memory(self) -> str:
        return "" if self.memory_gb is None else f"{self.memory_gb:.2f}"


RunJob = Callable[[Job], JobRecord]


@contextmanager
def local_processes(output: Path, workers: int) -> Iterator[RunJob]:
    """Yields what runs a job as a process of this machine, which ends with the context."""
    affinity = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    stopping, share = Event(), max(1, len(affinity(0)) // workers)
    try:
        yield lambda job: run_job(job, output, job.needs.cpus or share, stopping)
    finally:
        stopping.set()


def run_job(job: Job, output: Path, threads: int, stopping: Event | None = None) -> JobRecord:
    """Run a job to its end, or until `stopping` is set."""
    log = output / LOGS / f"{job.name}.log"
    answer, start = log.with_suffix(".json"), time.monotonic()
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        if job.edits_copy:
            shutil.rmtree(copy := output / job.name, ignore_errors=True)
            hidden = shutil.ignore_patterns(".*", f"*{PARTIAL}")
            shutil.copytree(job.source_in(output), copy, ignore=hidden)
        with answer.open("wb") as stdout, log.open("wb") as stderr:
            process = subprocess.Popen(
                process_command(job, output),
                env={
                    **os.environ,
                    **dict.fromkeys(THREADS, str(threads)),
                    "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                    "PYTHONUNBUFFERED": "1",
                },
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
            )
    except (OSError, shutil.Error) as error:
        return ended_job(job, "failed", f"it could not be started: {error}")
    memory = _wait(process, stopping or Event())
    status, result = process.returncode, {}
    with suppress(OSError, ValueError):
        result = json.loads(answer.read_bytes()) if status == 0 else {}
    answer.unlink(missing_ok=True)
    return replace(
        ended_job(job, "failed" if status else "done", _reason(status, log)),
        command=job.command(output),
        seconds=round(time.monotonic() - start, 2),
        threads=threads,
        memory_gb=memory,
        result=result,
    )


def ended_job(job: Job, status: Status, reason: str) -> JobRecord:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return JobRecord(job=job.name, verb=job.verb.name, status=status, reason=reason, ended=now)


def process_command(job: Job, output: Path) -> list[str]:
    parent, launcher = [], []
    if sys.platform.startswith("linux"):
        parent = [sys.executable, "-IS", "-c", END_WITH_PARENT, str(os.getpid())]
    if job.verb.name == "train" and (job.needs.gpus or 1) > 1:  # one process for each GPU
        launcher = ["-m", "torch.distributed.run", "--standalone"]
        launcher += ["--nproc-per-node", str(job.needs.gpus)]
    return [*parent, sys.executable, *launcher, "-m", "stylesplat", *job.command(output)]


def _wait(process: "subprocess.Popen[bytes]", stopping: Event) -> float | None:
    """Wait for a process; returns its peak memory in GB, where the system tells it."""
    memory = None
    try:
        while process.returncode is None and not stopping.is_set():
            if not hasattr(os, "wait4"):
                process.poll()
            elif (ended := os.wait4(process.pid, os.WNOHANG))[0]:
                process.returncode = os.waitstatus_to_exitcode(ended[1])
                unit = 1 if sys.platform == "darwin" else 1024  # bytes of ru_maxrss
                memory = round(ended[2].ru_maxrss * unit / 1e9, 3)
            time.sleep(PAUSE)
    finally:
        if process.returncode is None:  # the batch ends early, or Ray cancels its task
            process.terminate()
            try:
                process.wait(WORKER_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    return memory


def _reason(status: int, log: Path) -> str:
    if status == 0:
        return ""
    if status < 0:
        name = signal.Signals(-status).name
        return KILLED if name == "SIGKILL" else f"it crashed ({name}). See {log}."
    text = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    lines = [printable(line).strip() for line in text.splitlines() if line.strip()]
    last = lines[-1] if lines else f"it ended with status {status}."
    fault = FAULT.match(last)
    return fault[1] if fault else f"{last[:BRIEF]} See {log}."

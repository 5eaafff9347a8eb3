"""One job as a process of the command line, so that its end, however sudden, costs one job."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stylesplat.batch_jobs import end_with_parent
from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.errors import printable
from stylesplat.io.atomic import PARTIAL

LOGS = "logs"  # in the batch's folder: what each job has printed
PACKAGE = Path(__file__).parents[2]  # where this stylesplat is imported from
PATIENCE = 60.0  # seconds for a job to keep what it has, after SIGTERM
THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
SAID = "stylesplat"
FAULT = re.compile(rf"{SAID}(?: \w+)?: (.+)")  # the line in which a verb says what is at fault
KILLED = (
    "it was killed, perhaps because memory ran out. Use fewer workers, or with Ray "
    "`needs: {memory: GB}`"
)
BRIEF = 300  # characters of what a process said last, where that is no line of a verb's


@dataclass(frozen=True)
class Order:
    """A command to run."""

    name: str
    words: tuple[str, ...]
    """Behind `stylesplat`."""
    log: Path
    """Where its lines go; its result lies beside it."""
    threads: int
    copied: tuple[Path, Path] | None = None
    """A capture, and where it is to be copied first."""
    processes: int = 1
    """How many of them train together, by `torchrun`."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    status: int
    """0 if all is well, as for shells otherwise; below 0 the signal."""
    seconds: float
    reason: str
    """Why it failed, in a line."""
    result: dict[str, Any]
    memory_gb: float | None
    node: str = ""


def order_of(job: Job, output: Path, *, threads: int) -> Order:
    """The command of a job, whose folder lies in `output`."""
    folder = output / job.name
    source = job.source or output / str(job.after)
    copied, place = None, ("-o", str(folder))
    if job.content == "capture" and job.verb.makes is None:  # it would be written into
        copied, source, place = (source, folder), folder, ()
    elif job.is_in_folder:
        place = ()
    words = (*job.words(source, folder), *place, "--overwrite", "--json")
    log = output / LOGS / f"{job.name}.log"
    return Order(job.name, words, log, threads, copied, job.processes)


class Running:
    """A command that was started; ask `poll` for its end."""

    def __init__(self, order: Order) -> None:
        """Start it.

        Raises:
            OSError: If it cannot be, or what it needs cannot be copied.
        """
        self.order, self._start = order, time.monotonic()
        self._stdout = order.log.with_suffix(".json")
        order.log.parent.mkdir(parents=True, exist_ok=True)
        if order.copied:
            _copy_capture(*order.copied)
        with self._stdout.open("wb") as out, order.log.open("wb") as errors:
            self.process = subprocess.Popen(
                [*_ended_with_parent(), *_command(order)],
                env=_environment(order.threads),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=errors,
            )

    def poll(self) -> Outcome | None:
        """How it ended, if it has."""
        memory, status = None, self.process.returncode
        if status is None and hasattr(os, "wait4"):
            pid, ended, usage = os.wait4(self.process.pid, os.WNOHANG)
            if not pid:
                return None
            self.process.returncode = status = os.waitstatus_to_exitcode(ended)
            unit = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, in bytes
            memory = round(usage.ru_maxrss * unit / 1e9, 3)
        elif status is None and (status := self.process.poll()) is None:
            return None
        seconds = round(time.monotonic() - self._start, 2)
        return _outcome(self.order.log, self._stdout, status, seconds, memory)

    def end(self) -> None:
        """Ask it to stop; it may keep what it has."""
        with suppress(OSError):
            self.process.terminate()

    def kill(self) -> None:
        """Stop it at once."""
        with suppress(OSError):
            self.process.kill()


def end_all(commands: list[Running]) -> None:
    """Have commands stop, and wait until they have."""
    for command in commands:
        command.end()
    last = time.monotonic() + PATIENCE
    while any(command.poll() is None for command in commands):
        if time.monotonic() > last:
            for command in commands:
                command.kill()
        time.sleep(0.02)


def run_order(order: Order) -> Outcome:
    """Run a command to its end, in this thread; what cannot be started has failed."""
    command = None
    try:
        command = Running(order)
        while (outcome := command.poll()) is None:
            time.sleep(0.02)
        return outcome
    except OSError as error:
        return not_started(error)
    except BaseException:
        if command:
            end_all([command])
        raise


def not_started(error: OSError) -> Outcome:
    """What becomes of a command that could not be."""
    return Outcome(1, 0.0, f"it could not be started: {error.strerror or error}", {}, None)


def at_node(outcome: Outcome, node: str) -> Outcome:
    """An outcome that is known to come from another machine."""
    return replace(outcome, node=node)


def _command(order: Order) -> list[str]:
    launcher: list[str] = []
    if order.processes > 1:
        launcher = ["-m", "torch.distributed.run", "--standalone"]
        launcher += ["--nproc-per-node", str(order.processes)]
    return [sys.executable, *launcher, "-m", SAID, *order.words]


def _ended_with_parent() -> list[str]:
    """What goes before a command, for it to get SIGTERM when this process dies."""
    if not sys.platform.startswith("linux"):
        return []
    return [sys.executable, "-IS", end_with_parent.__file__, str(os.getpid())]


def _environment(threads: int) -> dict[str, str]:
    """That of a job: this package, and so many threads."""
    known = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    paths = os.pathsep.join([str(PACKAGE), *filter(None, known)])
    own = dict.fromkeys(THREADS, str(threads)) | {"PYTHONPATH": paths, "PYTHONUNBUFFERED": "1"}
    return {**os.environ, **own}


def _copy_capture(source: Path, target: Path) -> None:
    shutil.rmtree(target, ignore_errors=True)
    aside = shutil.ignore_patterns(".*", f"*{PARTIAL}")
    shutil.copytree(source, target, ignore=aside, copy_function=shutil.copyfile)


def _outcome(log: Path, stdout: Path, status: int, seconds: float, memory: float | None) -> Outcome:
    result: dict[str, Any] = {}
    if status == 0:
        with suppress(OSError, ValueError):
            found = json.loads(stdout.read_bytes())
            result = found if isinstance(found, dict) else {}
    with suppress(OSError):
        stdout.unlink()
    return Outcome(status, seconds, _reason(status, log), result, memory)


def _reason(status: int, log: Path) -> str:
    if status == 0:
        return ""
    if status == -signal.SIGKILL:
        return f"{KILLED}."
    if status < 0:
        return f"it crashed ({signal.Signals(-status).name}). See {log}."
    lines: list[str] = []
    with suppress(OSError):
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = [line for each in lines if (line := printable(each).strip())]
    last = lines[-1] if lines else f"it ended with status {status}."
    said = FAULT.match(last)
    return said[1] if said else f"{last[:BRIEF]} See {log}."

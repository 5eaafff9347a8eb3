"""Who runs jobs: processes of this machine, so many at a time."""

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.batch_jobs.orders import Outcome, Running, end_all, not_started, order_of
from stylesplat.errors import StyleSplatError

PAUSE = 0.05  # seconds between two looks at the processes


@runtime_checkable
class Crew(Protocol):
    """Runs jobs."""

    def threads_of(self, job: Job) -> int:
        """How many threads a job has."""
        ...

    @property
    def has_room(self) -> bool:
        """Whether another job can be begun."""
        ...

    @property
    def at_work(self) -> Sequence[str]:
        """The names of the jobs that have begun."""
        ...

    def begin(self, job: Job) -> None:
        """Run a job."""
        ...

    def ended(self) -> Iterator[tuple[Job, Outcome]]:
        """Wait a moment for jobs to end."""
        ...

    def close(self) -> None:
        """End what is still at work, which may keep what it has."""
        ...


class LocalCrew:
    """Processes of this machine."""

    def __init__(self, output: Path, workers: int) -> None:
        """Have so many work at a time, in a folder.

        Raises:
            StyleSplatError: If that is none.
        """
        if workers < 1:
            raise StyleSplatError(f"Jobs need at least one worker, got {workers}. Use --workers 1.")
        self._output, self._workers = output, workers
        self._running: list[tuple[Job, Running | Outcome]] = []
        self._share = max(1, cores() // workers)

    def threads_of(self, job: Job) -> int:
        """A worker's share of the cores, or what the job file says."""
        return job.needs.cpus or self._share

    @property
    def has_room(self) -> bool:
        """Whether a worker is idle."""
        return len(self._running) < self._workers

    @property
    def at_work(self) -> Sequence[str]:
        """The names of the jobs that have begun."""
        return [job.name for job, _ in self._running]

    def begin(self, job: Job) -> None:
        """Start a process."""
        order = order_of(job, self._output, threads=self.threads_of(job))
        try:
            self._running.append((job, Running(order)))
        except OSError as error:
            self._running.append((job, not_started(error)))

    def ended(self) -> Iterator[tuple[Job, Outcome]]:
        """Look whether any has ended, or wait a moment."""
        found = False
        for each in list(self._running):
            job, command = each
            outcome = command if isinstance(command, Outcome) else command.poll()
            if outcome is not None:
                self._running.remove(each)
                found = True
                yield job, outcome
        if not found:
            time.sleep(PAUSE)

    def close(self) -> None:
        """End what is still at work."""
        end_all([each for _, each in self._running if isinstance(each, Running)])


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1

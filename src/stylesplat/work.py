"""One thread that computes everything in a program with an interface, which never waits.

Rendering in several threads at once is not safe with every threading layer of numba.
"""

import threading
import time
from collections.abc import Callable, Iterator
from operator import itemgetter

Job = Callable[[], object]


class Worker:
    """Does jobs in order, and between them goes on with one long piece of work."""

    def __init__(self, failed: Callable[[Exception], None]) -> None:
        """Start the thread, which passes to `failed` what a job raises."""
        self._failed = failed
        self._changed = threading.Condition()
        self._jobs = list[tuple[bool, str, Job]]()  # the patient ones last
        self._lengthy: Iterator[object] | None = None
        self._busy, self._closed = False, False
        self._thread = threading.Thread(target=self._run, name="stylesplat worker", daemon=True)
        self._thread.start()

    def ask(self, job: Job, *, kind: str = "", patient: bool = False) -> None:
        """Add a job.

        Args:
            job: The function to call.
            kind: The job replaces those of this kind that have not begun.
            patient: Whether all other jobs come first, but not the long work.
        """
        with self._changed:
            known, new = [each[:2] for each in self._jobs], (patient, kind, job)
            if kind and patient and new[:2] in known:
                self._jobs[known.index(new[:2])] = new  # it keeps its place
            else:
                waiting = [each for each in self._jobs if not kind or each[:2] != new[:2]]
                self._jobs = sorted([*waiting, new], key=itemgetter(0))
            self._changed.notify_all()

    def go_on_with(self, steps: Iterator[object] | None) -> None:
        """Replace the long work: its next step is taken whenever there is no job; None ends it."""
        with self._changed:
            self._lengthy = steps
            self._changed.notify_all()

    @property
    def lengthy(self) -> Iterator[object] | None:
        """The long work."""
        return self._lengthy

    def breathe(self) -> None:
        """Within a long step, in the worker's thread: do the jobs that are not patient."""
        while threading.current_thread() is self._thread:
            with self._changed:
                if not self._jobs or self._jobs[0][0] or self._closed:
                    return
                job = self._jobs.pop(0)[-1]
            self._do(job)

    def settle(self, seconds: float = 240.0) -> bool:
        """Wait until there is nothing more to do; return whether that was in time."""
        end = time.monotonic() + seconds
        with self._changed:
            while self._busy or self._jobs or self._lengthy is not None:
                if self._closed or not self._changed.wait(max(0.0, end - time.monotonic())):
                    return False
        return True

    def close(self) -> None:
        """Finish the current job, and nothing else."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or self._jobs or self._lengthy)
                if self._closed:
                    return
                self._busy = True
                job = self._jobs.pop(0)[-1] if self._jobs else self._step
            self._do(job)

    def _do(self, job: Job) -> None:
        try:
            job()
        except Exception as error:
            self._failed(error)

    def _step(self) -> None:
        lengthy = self._lengthy
        assert lengthy is not None  # nobody else asks for a step
        try:
            next(lengthy)
        except BaseException as error:
            with self._changed:
                if self._lengthy is lengthy:
                    self._lengthy = None
            if not isinstance(error, StopIteration):
                raise

"""A session of the studio: its state, its listeners, and the thread that computes everything.

Rendering in several threads at once is not safe with every threading layer of numba.
"""

import ctypes
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path

import torch
from jaxtyping import Bool, Shaped
from msgspec.structs import replace
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import Observer, Task, observed
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.history import History, ObjectMasks, StudioState, hidden_rows
from stylesplat.studio_app.messages import Progress

WorkItem = Callable[[], object]
_page = ContextVar[int | None]("page", default=None)  # the only one to be told; None: all


class Stopped(Exception):
    """Ends long work that has no result yet."""


class Worker:
    """Does jobs in order, and between them goes on with one long piece of work."""

    def __init__(self, failed: Callable[[Exception], None]) -> None:
        """Start the thread, which passes to `failed` what a job raises."""
        self._failed = failed
        self._changed = threading.Condition()
        self._jobs = list[tuple[bool, str, WorkItem]]()  # the patient ones last
        self._lengthy: Iterator[object] | None = None
        self._busy, self._closed = False, False
        self._owner: object = None
        self._owning = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="stylesplat worker", daemon=True)
        self._thread.start()

    def ask(self, job: WorkItem, *, kind: str = "", patient: bool = False) -> None:
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

    def set_background_task(self, steps: Iterator[object] | None) -> None:
        """Replace the long work: its next step is taken whenever there is no job; None ends it."""
        with self._changed:
            self._lengthy = steps
            self._changed.notify_all()

    @property
    def background_task(self) -> Iterator[object] | None:
        """The long work."""
        return self._lengthy

    def run_urgent_jobs(self) -> None:
        """Within a long step, in the worker's thread: do the jobs that are not patient."""
        while threading.current_thread() is self._thread:
            with self._changed:
                if not self._jobs or self._jobs[0][0] or self._closed:
                    return
                job = self._jobs.pop(0)[-1]
            self._do(job)

    @contextmanager
    def interruptible(self, owner: object) -> Iterator[None]:
        """Within the block, in the worker's thread, `interrupt` raises `Stopped`."""
        self._owner = owner
        try:
            yield
        finally:
            with self._owning:  # what was interrupted just now is raised here at the latest
                self._owner = None

    def interrupt(self, owner: object) -> None:
        """End what is under way for an owner, between two steps of Python; from any thread."""
        with self._owning:
            if owner is not None and self._owner == owner:
                self._owner = None
                thread = ctypes.c_ulong(self._thread.ident or 0)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, ctypes.py_object(Stopped))

    def wait_until_idle(self, seconds: float = 240.0) -> bool:
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

    def _do(self, job: WorkItem) -> None:
        owner, self._owner = self._owner, None  # that of a job which lets this one in between
        try:
            job()
        except Exception as error:
            self._failed(error)
        finally:
            self._owner = owner

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


Change = Callable[[StudioState], StudioState | None]
SESSION_BUSY = "An object is being painted. Wait until it is done, or press Stop."


class Callbacks(list[Callable[..., object]]):
    """Functions that the worker calls one after the other."""

    def call(self, *arguments: object, **options: object) -> None:
        for callback in [*self]:
            callback(*arguments, **options)


@dataclass(frozen=True, eq=False)
class Display:
    splats: Splats
    hidden: Bool[Tensor, " N"] | None = None
    """Gaussians that are not drawn."""

    @cached_property
    def visible(self) -> Splats:
        return self.splats if self.hidden is None else self.splats[~self.hidden]

    def shown(self, picked: Shaped[Tensor, " N"]) -> Shaped[Tensor, " M"]:
        """A mask, or shares, of the visible Gaussians."""
        return picked if self.hidden is None else picked[~self.hidden]


class Session:
    """What all browsers of a studio share. All computing is done in the worker's thread."""

    def __init__(self, scene: Scene, *, folder: Path) -> None:
        self.history = History(StudioState(scene))
        self.masks = ObjectMasks()
        self.folder = folder
        self.saved = self.history.now
        """The state that was saved last, or opened."""
        self.preview: Display | None = None
        """What browsers display in place of the state during a painting."""
        self.progress: Progress | None = None
        self.export: Progress | None = None
        """The progress of an export, which runs beside all else."""
        self.painting = False
        """Whether an object is being painted: the scene does not change then."""
        self.interrupt: Callable[[], bool] = lambda: False
        """Stops the painting and keeps its result so far; returns whether there was one."""
        self.on_change = Callbacks()
        self.on_progress = Callbacks()
        """Called where `progress` alone has changed."""
        self.on_painted = Callbacks()
        """Called with an object and the title of its picture when it is painted, or stopped."""
        self.on_message = Callbacks()
        """Called with a line, whether it reports a failure, and the page for it; None for all."""
        self.on_send = Callbacks()
        """Called with a page's number, the kind of a message, and the message for it alone."""
        self.stopping = threading.Event()
        """Set as soon as the studio is to end."""
        self.worker = Worker(self.report)
        self._display = Display(scene.splats)

    @property
    def state(self) -> StudioState:
        return self.history.now

    @property
    def display(self) -> Display:
        return self.preview or self.display_of(self.state)

    def display_of(self, state: StudioState) -> Display:
        """What a state displays: the same object as before if it is the same."""
        splats, hidden, known = state.scene.splats, hidden_rows(state, self.masks), self._display
        same = hidden is known.hidden
        if hidden is not None and known.hidden is not None:
            same = torch.equal(hidden, known.hidden)
        if known.splats is not splats or not same:
            self._display = Display(splats, hidden)
        return self._display

    @property
    def unsaved(self) -> bool:
        return self.state.scene is not self.saved.scene

    def do(
        self,
        change: Change,
        *,
        merge: Callable[[StudioState], object] = lambda state: None,
        kind: str = "",
    ) -> None:
        """Ask for a change of the state; `kind` as for `ask`.

        `merge` tells, by the state before, what `History.add` merges it by.
        """

        def job() -> None:
            before = self.state
            key, state = merge(before), change(before)
            if state is None or state is self.state:
                return
            if self.painting and state.scene is not self.state.scene:
                raise StyleSplatError(SESSION_BUSY)
            self.history.add(state, merge=key)
            self.on_change.call()

        self.ask(job, kind=kind)

    def step(self, rows: int) -> None:
        """Ask for undo or redo. Undo first ends a painting, and takes its result so far back."""
        self._move(lambda: rows)

    def go_to(self, number: int) -> None:
        """Ask for a step of the history by its number. A painting is ended as by `step`."""
        self._move(lambda: self.history.row_of(number) - self.history.row, anyway=True)

    def _move(self, rows: Callable[[], int], *, anyway: bool = False) -> None:
        """Go by so many rows; `anyway`: also if that ended a painting that had no step yet."""

        def job() -> None:
            if self.painting:
                before = self.state
                if rows() > 0 or not self.interrupt():
                    raise StyleSplatError(SESSION_BUSY)
                if self.state is before and not anyway:  # the painting had no step yet
                    return
            self.history.step(rows())
            self.preview = None
            self.on_change.call()

        self.ask(job)

    def ask(self, job: Callable[[], object], *, kind: str = "", patient: bool = False) -> None:
        """Ask the worker for a job, whose messages go to the user; see `Worker.ask`."""
        page = _page.get()

        def job_with_messages() -> None:
            with self.telling(page), self.listening():
                try:
                    job()
                except Exception as error:
                    self.report(error)

        self.worker.ask(job_with_messages, kind=kind, patient=patient)

    def tell(self, line: str, *, failure: bool = False) -> None:
        self.on_message.call(line, failure, _page.get())

    @contextmanager
    def telling(self, page: int | None) -> Iterator[None]:
        """Within the block, and in jobs that are asked for there, messages go to a page alone."""
        token = _page.set(page)
        try:
            yield
        finally:
            _page.reset(token)

    def listening(
        self,
        stopped: Callable[[], bool] = lambda: False,
        counted: Callable[[float], None] = lambda share: None,
    ) -> AbstractContextManager[None]:
        """Within the block the library's messages go to the user, and `stopped` may end it.

        `counted` is called with the share of each task that is done.
        """
        return observed(_SessionObserver(self, stopped, counted))

    def report(self, error: Exception) -> None:
        if not isinstance(error, StyleSplatError):
            traceback.print_exception(error)  # our fault: the terminal gets the whole trace
            error = StyleSplatError(
                "This failed by a fault of the studio, and changed nothing. Its terminal says more."
            )
        self.tell(str(error), failure=True)


class _SessionObserver(Observer):
    """Passes messages on, and lets short work in between the parts of long work."""

    def __init__(
        self, session: Session, stopped: Callable[[], bool], counted: Callable[[float], None]
    ) -> None:
        self._session, self._stopped, self._counted = session, stopped, counted
        self._done, self._total = 0.0, 1.0

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[Task]:
        self._done, self._total = float(done), float(total or 1)
        progress = self._session.progress
        if progress is not None and progress.share == 0:
            self._session.progress = replace(progress, doing=what)
            self._session.on_progress.call()
        yield self

    def advance(self, amount: int | float = 1) -> None:
        self._session.worker.run_urgent_jobs()
        if self._stopped():
            raise Stopped
        self._done += amount
        self._counted(min(1.0, self._done / self._total))

    def say(self, line: str) -> None:
        self._session.tell(line)

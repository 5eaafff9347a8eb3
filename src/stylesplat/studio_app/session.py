"""A session of the studio: its state, the thread that works on it, and its listeners."""

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.figures.live_splats import ViewerSplats
from stylesplat.progress import Observer, Silence, Task, observed
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.history import History, ObjectMasks, StudioState, display_of
from stylesplat.work import Worker

Change = Callable[[StudioState], StudioState]


class Stopped(Exception):
    """Ends long work that has no result yet."""


class Callbacks(list[Callable[..., None]]):
    """Functions that the worker calls one after the other."""

    def call(self, *arguments: object, **options: object) -> None:
        for callback in self:
            callback(*arguments, **options)


@dataclass(frozen=True)
class Progress:
    """The progress of long work."""

    what: str
    share: float
    """How much of it is done, 0 to 1."""
    left: float | None = None
    """Estimated seconds that it still takes."""
    doing: str = ""
    """The preparation that is under way."""


class Session:
    """What all browsers of a studio share. All computing is done in the worker's thread."""

    def __init__(self, scene: Scene, *, folder: Path) -> None:
        self.history = History(StudioState(scene))
        self.masks = ObjectMasks()
        self.folder = folder
        """Where Save writes."""
        self.saved = self.history.now
        """The state that was saved last, or opened."""
        self.preview: ViewerSplats | None = None
        """What browsers display in place of the state during a painting."""
        self.progress: Progress | None = None
        self.painting = False
        """Whether an object is being painted, or a video made: the scene does not change then."""
        self.interrupt: Callable[[], bool] = lambda: False
        """Stops the painting and keeps its result so far; returns whether there was one."""
        self.greetings = list[str]()
        """Messages for each new browser."""
        self.on_change = Callbacks()
        self.on_progress = Callbacks()
        """Called where `progress` alone has changed."""
        self.on_painted = Callbacks()
        """Called with an object and the title of its picture when it is painted, or stopped."""
        self.on_message = Callbacks()
        """Called with a line for the user, and whether it reports a failure."""
        self.worker = Worker(self._report)

    @property
    def state(self) -> StudioState:
        return self.history.now

    @property
    def display(self) -> ViewerSplats:
        """What browsers display now."""
        return self.preview or display_of(self.state, self.masks)

    @property
    def unsaved(self) -> bool:
        """Whether the scene differs from the saved one."""
        return self.state.scene is not self.saved.scene

    def do(self, change: Change, *, merge: object = None, kind: str = "") -> None:
        """Ask for a change of the state; `merge` as for `History.add`, `kind` as for `ask`."""

        def job() -> None:
            state = change(self.state)
            if state is not self.state:
                if self.painting and state.scene is not self.state.scene:
                    raise StyleSplatError(
                        "An object is being painted. Wait until it is done, or press Stop."
                    )
                self.history.add(state, merge=merge)
                self.on_change.call()

        self.ask(job, kind=kind)

    def step(self, rows: int) -> None:
        """Ask for undo or redo. Undo first ends a painting, and takes its result so far back."""

        def job() -> None:
            if self.painting:
                before = self.state
                if rows > 0 or not self.interrupt():
                    raise StyleSplatError(
                        "An object is being painted, or a video made. Wait until it is done, or "
                        "press Stop."
                    )
                if self.state is before:  # the painting had no step yet
                    return
            self.history.step(rows)
            self.preview = None
            self.on_change.call()

        self.ask(job)

    def ask(self, job: Callable[[], object], *, kind: str = "", patient: bool = False) -> None:
        """Ask the worker for a job, whose messages go to the user; see `Worker.ask`."""

        def job_with_messages() -> None:
            with self.listening():
                job()

        self.worker.ask(job_with_messages, kind=kind, patient=patient)

    def tell(self, line: str, *, failure: bool = False) -> None:
        """Show a line to the user."""
        self.on_message.call(line, failure)

    @contextmanager
    def listening(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[None]:
        """Within the block the library's messages go to the user, and `stopped` may end it."""
        with observed(_SessionObserver(self, stopped)):
            yield

    def close(self) -> None:
        self.worker.close()
        self.history.close()

    def _report(self, error: Exception) -> None:
        if not isinstance(error, StyleSplatError):
            traceback.print_exception(error)  # our fault: the terminal gets the whole trace
        self.tell(str(error), failure=True)


class _SessionObserver(Silence, Observer):
    """Passes messages on, and lets short work in between the parts of long work."""

    def __init__(self, session: Session, stopped: Callable[[], bool]) -> None:
        self._session, self._stopped = session, stopped

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[Task]:
        progress = self._session.progress
        if progress is not None and progress.share == 0:
            self._session.progress = replace(progress, doing=what)
            self._session.on_progress.call()
        yield self

    def advance(self, amount: int | float = 1) -> None:
        self._session.worker.breathe()
        if self._stopped():
            raise Stopped

    def say(self, line: str) -> None:
        self._session.tell(line)

"""One run of the studio: its states, the thread that works on them, and who is told of changes."""

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.figures.live_splats import ViewerSplats
from stylesplat.progress import Observer, Silence, Task, observed
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.history import History
from stylesplat.studio_app.studio_state import Masks, State, shown
from stylesplat.work import Worker

Change = Callable[[State], State]


class Stopped(Exception):
    """Long work was to end before it had anything to show."""


@dataclass(frozen=True)
class Progress:
    """Long work that is under way."""

    what: str
    """In a few words."""
    share: float
    """How much of it is done, 0 to 1."""
    left: float | None = None
    """Seconds that it may still take; None if nobody knows."""
    doing: str = ""
    """What is prepared."""


class Session:
    """What all browsers of a studio share. All computing is done in the worker's thread."""

    def __init__(self, scene: Scene, *, folder: Path) -> None:
        """Begin with a scene.

        Args:
            scene: What is worked on.
            folder: Where it is saved to.
        """
        self.history = History(State(scene))
        self.masks = Masks()
        self.folder = folder
        """Where Save writes."""
        self.saved = self.history.now
        """The state that was saved last, or opened."""
        self.preview: ViewerSplats | None = None
        """What is shown in place of the state while something is painted."""
        self.progress: Progress | None = None
        """What is under way."""
        self.painting = False
        """Whether something is being painted, or filmed: the scene stays as it is meanwhile."""
        self.interrupt: Callable[[], bool] = lambda: False
        """Ends at once what is being painted, keeping what there is of it; whether it could."""
        self.greetings = list[str]()
        """What everybody is told who comes to see."""
        self._changed, self._progressed = list[Callable[[], None]](), list[Callable[[], None]]()
        self._told = list[Callable[[str, bool], None]]()
        self._painted = list[Callable[[str, str], None]]()
        self.worker = Worker(self._failed)

    @property
    def state(self) -> State:
        """What is shown."""
        return self.history.now

    @property
    def shown(self) -> ViewerSplats:
        """What is to be seen now."""
        return self.preview or shown(self.state, self.masks)

    @property
    def unsaved(self) -> bool:
        """Whether the scene differs from what was saved last."""
        return self.state.scene is not self.saved.scene

    def on_change(self, callback: Callable[[], None]) -> None:
        """Have something called in the worker's thread whenever anything is another."""
        self._changed.append(callback)

    def on_progress(self, callback: Callable[[], None]) -> None:
        """Have something called in the worker's thread when nothing but `progress` is another."""
        self._progressed.append(callback)

    def on_painted(self, callback: Callable[[str, str], None]) -> None:
        """Have told, when an object is painted or stopped, its name and the picture's."""
        self._painted.append(callback)

    def on_word(self, callback: Callable[[str, bool], None]) -> None:
        """Have lines for the user told, and whether each is of a failure."""
        self._told.append(callback)

    def do(self, change: Change, *, merge: object = None, kind: str = "") -> None:
        """Have the state changed, soon.

        Args:
            change: Makes another state of the one that there will be then.
            merge: See `History.add`.
            kind: See `Worker.ask`.
        """

        def job() -> None:
            state = change(self.state)
            if state is not self.state:
                if self.painting and state.scene is not self.state.scene:
                    raise StyleSplatError(
                        "Something is being painted. Wait until it is done, or press Stop."
                    )
                self.history.add(state, merge=merge)
                self.tell_change()

        self.ask(job, kind=kind)

    def step(self, rows: int) -> None:
        """Undo or redo, soon. Undo ends a painting first, and takes what there is of it back."""

        def job() -> None:
            if self.painting:
                before = self.state
                if rows > 0 or not self.interrupt():
                    raise StyleSplatError(
                        "Something is being painted or filmed. Wait until it is done, or Stop it."
                    )
                if self.state is before:  # there was no stroke yet
                    return
            self.history.step(rows)
            self.preview = None
            self.tell_change()

        self.ask(job)

    def ask(self, job: Callable[[], object], *, kind: str = "", patient: bool = False) -> None:
        """Have something done in the worker's thread, its words told to the user."""

        def told() -> None:
            with self.listening():
                job()

        self.worker.ask(told, kind=kind, patient=patient)

    def tell_change(self) -> None:
        """Something is another."""
        for callback in self._changed:
            callback()

    def tell_progress(self) -> None:
        """`progress` is another."""
        for callback in self._progressed:
            callback()

    def tell_painted(self, name: str, title: str) -> None:
        """An object is painted to the end, or was stopped."""
        for callback in self._painted:
            callback(name, title)

    def tell(self, line: str, *, failure: bool = False) -> None:
        """Say something to the user."""
        for callback in self._told:
            callback(line, failure)

    @contextmanager
    def listening(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[None]:
        """Within the block the library's words are the user's.

        Args:
            stopped: Whether the work of the block is to end at once; then it raises Stopped.
        """
        with observed(_Ear(self, stopped)):
            yield

    def close(self) -> None:
        """End the thread."""
        self.worker.close()
        self.history.close()

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, StyleSplatError):
            traceback.print_exception(error)  # a fault of ours: the terminal has it whole
        self.tell(str(error), failure=True)


class _Ear(Silence, Observer):
    """Passes words on, and lets short work in between the parts of long work."""

    def __init__(self, session: Session, stopped: Callable[[], bool]) -> None:
        self._session, self._stopped = session, stopped

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[Task]:
        """Say what is done before the first stroke."""
        progress = self._session.progress
        if progress is not None and progress.share == 0:
            self._session.progress = replace(progress, doing=what)
            self._session.tell_progress()
        yield self

    def advance(self, amount: int | float = 1) -> None:
        """Something may wait."""
        self._session.worker.breathe()
        if self._stopped():
            raise Stopped

    def say(self, line: str) -> None:
        """Tell the user."""
        self._session.tell(line)

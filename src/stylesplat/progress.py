"""How work tells that it goes on: silent unless somebody listens.

The library reports what it does to an `Observer`; the command line installs one that draws bars, a
program of your own installs another, or none.
"""

from collections.abc import Iterable, Iterator, Sized
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Protocol, TypeVar, runtime_checkable

T = TypeVar("T")


@runtime_checkable
class Task(Protocol):
    """Work that is under way."""

    def advance(self, amount: int | float = 1) -> None:
        """So much more is done."""
        ...

    def note(self, text: str) -> None:
        """How it is going, in a few words."""
        ...


@runtime_checkable
class Observer(Protocol):
    """Who is told."""

    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> AbstractContextManager[Task]:
        """Work begins; it ends with the context.

        Args:
            what: What is done.
            total: How much there is to do; None if nobody knows.
            unit: What is counted.
            done: How much of it an earlier run has done.
        """
        ...

    def say(self, line: str) -> None:
        """Something that the user should know."""
        ...


class Silence:
    """The observer that there is if nobody listens."""

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[Task]:
        """Tell nobody."""
        yield self

    def advance(self, amount: int | float = 1) -> None:
        """Count nothing."""

    def note(self, text: str) -> None:
        """Tell nobody."""

    def say(self, line: str) -> None:
        """Tell nobody."""


_everywhere: list[Observer] = [Silence()]  # the one of the whole process
_here: ContextVar[Observer | None] = ContextVar("observer", default=None)


def listen(observer: Observer) -> None:
    """Tell an observer from now on, whichever thread works."""
    _everywhere[:] = [observer]


@contextmanager
def observed(observer: Observer) -> Iterator[None]:
    """Within the block tell this observer only; other threads keep theirs."""
    token = _here.set(observer)
    try:
        yield
    finally:
        _here.reset(token)


def say(line: str) -> None:
    """Tell the user something in one line."""
    _observer().say(line)


def task(
    what: str, total: int | float | None = None, *, unit: str = "step", done: int | float = 0
) -> AbstractContextManager[Task]:
    """Announce work that is counted by hand; see `Observer.task`."""
    return _observer().task(what, total, unit, done)


def track(
    items: Iterable[T], what: str, *, unit: str = "view", total: int | None = None
) -> Iterator[T]:
    """The same items, counted as they are asked for.

    Args:
        items: What is worked on.
        what: What is done with them.
        unit: What one of them is.
        total: How many there are, if they do not know it themselves.
    """
    total = len(items) if isinstance(items, Sized) else total
    with task(what, total, unit=unit) as counted:
        for item in items:
            yield item
            counted.advance()


def _observer() -> Observer:
    return _here.get() or _everywhere[0]

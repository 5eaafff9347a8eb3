"""How work reports its progress: to an `Observer`, and to nobody unless one is installed.

The command line installs one that draws bars; a program of your own installs another, or none.
"""

import sys
from collections.abc import Iterable, Iterator, Sized
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Protocol, TypeVar, runtime_checkable

from stylesplat.interrupts import raise_if_interrupted

T = TypeVar("T")


@runtime_checkable
class Task(Protocol):
    """Work that is under way."""

    def advance(self, amount: int | float = 1) -> None:
        """Count what is done."""

    def note(self, text: str) -> None:
        """Show a few words about the work, such as the loss."""


class Observer(Task):
    """Receives progress and messages; this one ignores them."""

    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> AbstractContextManager[Task]:
        """Work begins, and ends with the context.

        Args:
            what: What is done.
            total: How much there is to do; None if that is unknown.
            unit: What is counted; empty if nothing is.
            done: How much of it an earlier run has done.
        """
        return nullcontext(self)

    def say(self, line: str) -> None:
        """Receive a message for the user."""


SILENCE = Observer()
_observer: ContextVar[Observer] = ContextVar("observer", default=SILENCE)


@contextmanager
def observed(observer: Observer) -> Iterator[None]:
    """Install an observer within the block; other threads keep theirs."""
    token = _observer.set(observer)
    try:
        yield
    finally:
        _observer.reset(token)


def say(line: str) -> None:
    """Send the user a message of one line."""
    _observer.get().say(line)


class _InterruptibleTask:
    """A task of an observer, which Ctrl-C interrupts where it advances."""

    def __init__(self, shown: Task) -> None:
        self._shown, self.note = shown, shown.note

    def advance(self, amount: int | float = 1) -> None:
        self._shown.advance(amount)
        raise_if_interrupted()


@contextmanager
def task(
    what: str, total: int | float | None = None, *, unit: str = "step", done: int | float = 0
) -> Iterator[Task]:
    """Report work that is counted by hand; see `Observer.task`.

    Raises:
        Interrupted: Where the task advances after Ctrl-C, in the command line.
    """
    with _observer.get().task(what, total, unit, done) as shown:
        yield _InterruptibleTask(shown)


def uncounted(what: str) -> AbstractContextManager[Task]:
    """Report work of which nothing can be counted."""
    return task(what, unit="")


def track(
    items: Iterable[T], what: str, *, unit: str = "view", total: int | None = None
) -> Iterator[T]:
    """Yield the items and count them; `total` is for items that have no length."""
    total = len(items) if isinstance(items, Sized) else total
    with task(what, total, unit=unit) as counted:
        for item in items:
            yield item
            counted.advance()


def write_lines(*lines: str) -> None:
    """Write lines to stderr in one piece: Ctrl-C leaves no half line."""
    print("".join(f"{line}\n" for line in lines), end="", file=sys.stderr, flush=True)

"""Progress where no terminal is, as in logs: now and then a line on stderr."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stylesplat.cli.once import Once
from stylesplat.stderr import write_lines

EVERY = 10.0  # seconds between two lines of a task
SURE = 0.02  # of the whole: the first step alone takes much longer than the others
MEGA = 1_000_000


class _Counted:
    """A task as a line every ten seconds."""

    def __init__(
        self,
        what: str,
        total: int | float | None,
        unit: str,
        done: int | float,
        clock: Callable[[], float],
    ) -> None:
        self._what, self._total, self._unit, self._clock = what, total, unit, clock
        self._first = self._done = done
        self._note = ""
        self._start = self._last = clock()
        self._told = False

    def advance(self, amount: int | float = 1) -> None:
        """Say how far it is, if that was long ago."""
        self._done += amount
        now = self._clock()
        if now - self._last < EVERY:
            return
        self._last, self._told = now, True
        if self._done == self._total:  # the end will be said
            return
        note = f" ({self._note})" if self._note else ""
        write_lines(f"{self._what}: {self._stand()}{self._left(now)}{note}")

    def note(self, text: str) -> None:
        """Keep it for the next line."""
        self._note = text

    def end(self) -> None:
        """Say that it ended, if anything was said, and how far it was if that is not all."""
        if not self._told:
            return
        whole = self._total is None or self._done >= self._total
        how = "done" if whole else "ended"
        seconds = self._clock() - self._start
        write_lines(f"{self._what}: {how}, {self._stand()} in {_duration(seconds)}")

    def _stand(self) -> str:
        if self._unit == "B":
            of = "" if self._total is None else f" of {self._total / MEGA:.1f}"
            return f"{self._done / MEGA:.1f}{of} MB"
        of = "" if self._total is None else f" of {self._total:.0f}"
        return f"{self._done:.0f}{of} {_plural(self._unit)}"

    def _left(self, now: float) -> str:
        """How long it will take from now on, at the speed so far."""
        done = self._done - self._first
        if self._total is None or done < SURE * self._total or self._done >= self._total:
            return ""
        return f", {_duration((now - self._start) * (self._total - self._done) / done)} left"


class LogLines(Once):
    """The observer of the command line where nobody watches: no bars, no control characters."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` gives the seconds by which lines come."""
        super().__init__()
        self._clock = clock

    def close(self) -> None:
        """There is nothing to take away."""

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[_Counted]:
        """Write lines about work that takes long, and one at its end."""
        counted = _Counted(what, total, unit, done, self._clock)
        try:
            yield counted
        finally:
            counted.end()

    def _write(self, line: str) -> None:
        write_lines(line)


def _plural(unit: str) -> str:
    if unit == "s":
        return unit
    return f"{unit}es" if unit.endswith("ch") else f"{unit}s"


def _duration(seconds: float) -> str:
    """As people say it.

    Example:
        >>> _duration(8.2), _duration(140.0), _duration(8000.0)
        ('8 s', '2 min', '2.2 h')
    """
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 99.5 * 60 else f"{seconds / 3600:.1f} h"

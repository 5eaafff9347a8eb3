"""Progress on stderr by tqdm: bars in a terminal; elsewhere, as in logs, a line now and then.

A thread draws the bar of work that does not advance, so that its clock goes on.
"""

import sys
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from threading import Event, Thread
from time import time
from typing import Any

from tqdm import tqdm

from stylesplat.progress import Observer, write_lines

MOMENT, LOG_MOMENT = 0.5, 2.0  # seconds of work that is not worth a bar, or a line in a log
EVERY, LOG_EVERY = 1.0, 10.0  # seconds between two drawings of work that does not advance
TICK = 0.25  # seconds between two looks at it
RATE_SECONDS = 30.0  # the last ones, whose speed tells the time left
BAR_FORMAT = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"
OF_SECONDS = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}{postfix}]"
UNCOUNTED = "{desc}: {elapsed}{postfix}"
UNBOUNDED = "{desc}: {n_fmt} {unit}s [{elapsed}{postfix}]"


class _Bar(tqdm):
    """A task. Without `display` a bar that is drawn before its delay would not end its line.

    The rate is measured here: tqdm's is wrong where the thread draws between two of its drawings.
    """

    def __init__(self, *, initial: int | float, **options: Any) -> None:
        self._before = deque([(time(), initial)])
        super().__init__(initial=initial, **options)

    @property
    def format_dict(self) -> dict[str, Any]:
        began, done = self._before[0]
        seconds = time() - began
        rate = (self.n - done) / seconds if self.n > done and seconds > 0 else None
        return {**super().format_dict, "rate": rate}

    def advance(self, amount: int | float = 1) -> None:
        self.update(amount)

    def note(self, text: str) -> None:
        self.set_postfix_str(text, refresh=False)

    def display(self, *arguments: Any, **options: Any) -> Any:
        if self.delay > 0:
            self.last_print_t = max(self.last_print_t, self.start_t + self.delay)
        now = time()
        while len(self._before) > 1 and now - self._before[1][0] > RATE_SECONDS:
            self._before.popleft()
        drawn = super().display(*arguments, **options)
        self._before.append((now, self.n))
        return drawn

    def tick(self, every: float) -> None:
        """Draw it if it was not drawn for so many seconds, or never and its delay is over."""
        with self.get_lock():
            now, shown = time(), self.start_t + self.delay
            is_due = self.last_print_t < shown or now - self.last_print_t >= every
            if not self.disable and now >= shown and is_due:
                self.refresh(nolock=True)
                self.last_print_t = now


class _Lines:
    """A file for tqdm that writes what it draws as lines."""

    def write(self, text: str) -> None:
        write_lines(*filter(None, (line.strip() for line in text.replace("\r", "\n").split("\n"))))

    def flush(self) -> None: ...


class Bars(Observer):
    """The observer of the command line. It says no line twice."""

    def __init__(self, *, terminal: bool | None = None, delay: int | float | None = None) -> None:
        """`delay` is seconds until a task is shown, and between two lines of one in a log."""
        self._terminal = sys.stderr.isatty() if terminal is None else terminal
        moment, every = (MOMENT, EVERY) if self._terminal else (LOG_MOMENT, LOG_EVERY)
        self._delay = moment if delay is None else delay
        self._every = every if delay is None else delay
        self._said, self._drawn, self._closed = set[str](), list[_Bar](), Event()
        self._fills_gaps, self._gap = False, ExitStack()
        Thread(target=self._tick, daemon=True, name="stylesplat-bars").start()

    def _tick(self) -> None:
        while not self._closed.wait(TICK):
            for bar in self._drawn[-1:]:
                bar.tick(self._every)

    def fill_gaps(self) -> None:
        """From now on show that the command works where no task is under way."""
        self._fills_gaps = True
        self._fill_gap("starting")

    def _fill_gap(self, what: str) -> None:
        if self._fills_gaps and not self._drawn:
            self._gap.enter_context(self._bar(what, None, "", 0))

    def clear(self) -> None:
        """End what is drawn: also of generators that are left in the middle and end late."""
        self._gap.close()
        for bar in self._drawn:
            bar.close()

    def close(self) -> None:
        """Draw no more."""
        self._closed.set()
        self._fills_gaps = False
        self.clear()

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[_Bar]:
        """Show work that takes longer than a moment; see `progress.Observer`."""
        self._gap.close()
        try:
            with self._bar(what, total, unit, done) as bar:
                yield bar
        finally:
            self._fill_gap("working")

    @contextmanager
    def _bar(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[_Bar]:
        drawn = OF_SECONDS if unit == "s" else BAR_FORMAT
        if total is None:
            drawn = UNBOUNDED if unit else UNCOUNTED
        options: dict[str, Any] = {"file": sys.stderr, "bar_format": drawn}
        if not self._terminal:
            without_bar = drawn.replace("{bar}| ", "")
            options = {"file": _Lines(), "bar_format": without_bar, "position": 0}
            options |= {"mininterval": self._every, "maxinterval": 1e9, "miniters": 1}
        with _Bar(
            desc=what,
            total=total,
            unit=unit,
            initial=done,
            delay=self._delay,
            leave=bool(unit),
            unit_scale=unit == "B",
            **options,
        ) as bar:
            self._drawn.append(bar)
            try:
                yield bar
            finally:
                self._drawn.remove(bar)

    def say(self, line: str) -> None:
        """Write a line in one piece, above the bars that there are."""
        if line in self._said:
            return
        self._said.add(line)
        if self._terminal:
            tqdm.write(f"{line}\n", file=sys.stderr, end="")
        else:
            write_lines(line)

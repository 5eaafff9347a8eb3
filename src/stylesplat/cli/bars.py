"""Progress on stderr by tqdm: bars in a terminal; elsewhere, as in logs, a line now and then."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from stylesplat.progress import Observer, write_lines

MOMENT = 0.5  # seconds of work that is not worth a bar
EVERY = 10.0  # seconds between two lines of a task in a log
BAR_FORMAT = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"
OF_SECONDS = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}{postfix}]"


class _Bar(tqdm):
    """A task. Without `display` a bar that is drawn before its delay would not end its line."""

    def advance(self, amount: int | float = 1) -> None:
        self.update(amount)

    def note(self, text: str) -> None:
        self.set_postfix_str(text, refresh=False)

    def display(self, *arguments: Any, **options: Any) -> Any:
        if self.delay > 0:
            self.last_print_t = max(self.last_print_t, self.start_t + self.delay)
        return super().display(*arguments, **options)


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
        self._delay = (MOMENT if self._terminal else EVERY) if delay is None else delay
        self._said, self._drawn = set[str](), list[_Bar]()

    def close(self) -> None:
        """Draw no more: also of generators that are left in the middle, which close theirs late."""
        for bar in self._drawn:
            bar.close()

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[_Bar]:
        """Show work that takes longer than a moment; see `progress.Observer`."""
        drawn = OF_SECONDS if unit == "s" else BAR_FORMAT
        options: dict[str, Any] = {"file": sys.stderr, "bar_format": drawn}
        if not self._terminal:
            without_bar = drawn.replace("{bar}| ", "")
            options = {"file": _Lines(), "bar_format": without_bar, "position": 0}
            options |= {"mininterval": self._delay, "maxinterval": 1e9, "miniters": 1}
        with _Bar(
            desc=what,
            total=total,
            unit=unit,
            initial=done,
            delay=self._delay,
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

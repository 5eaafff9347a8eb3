"""Progress bars and lines on stderr: stdout is for JSON."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from stylesplat.cli.once import Once

if TYPE_CHECKING:
    from tqdm import tqdm

DELAY = 0.5  # seconds of work that is not worth a bar
SECONDS = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}{postfix}]"  # how time is counted


class _Bar:
    """A task as a bar."""

    def __init__(self, bar: "tqdm") -> None:
        self._bar = bar

    def advance(self, amount: int | float = 1) -> None:
        """Move it."""
        self._bar.update(amount)

    def note(self, text: str) -> None:
        """Write behind it, the next time that it is drawn."""
        self._bar.set_postfix_str(text, refresh=False)


class Bars(Once):
    """The observer of the command line; tqdm, which `--help` can do without, is loaded late."""

    def __init__(self) -> None:
        super().__init__()
        self._drawn: list[tqdm] = []

    def close(self) -> None:
        """Draw no more: also of generators that are left in the middle, which close theirs late."""
        for bar in self._drawn:
            bar.close()

    @contextmanager
    def task(
        self, what: str, total: int | float | None, unit: str, done: int | float
    ) -> Iterator[_Bar]:
        """Draw a bar for work that takes longer than a moment."""
        with _bars()(
            desc=what,
            total=total,
            unit=unit,
            initial=done,
            delay=DELAY,
            unit_scale=unit == "B",
            bar_format=SECONDS if unit == "s" else None,
            file=sys.stderr,
        ) as bar:
            self._drawn.append(bar)
            try:
                yield _Bar(bar)
            finally:
                self._drawn.remove(bar)

    def _write(self, line: str) -> None:
        """Above the bars that there are, and in one piece, as `write_lines` does."""
        from tqdm import tqdm

        tqdm.write(f"{line}\n", file=sys.stderr, end="")


@cache
def _bars() -> "type[tqdm]":
    """tqdm's, which leave no half line: theirs forget to end one that is drawn before its delay.

    A line that is written draws all bars anew.
    """
    from tqdm import tqdm

    class Ended(tqdm):
        def display(self, *arguments: Any, **options: Any) -> Any:
            if self.delay > 0:
                self.last_print_t = max(self.last_print_t, self.start_t + self.delay)
            return super().display(*arguments, **options)

    return Ended

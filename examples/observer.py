"""Show progress in a program of your own, and let it cancel: what a plug-in needs.

python examples/observer.py garden-scene vase wave.jpg painted
"""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import stylesplat as ss
from stylesplat.progress import Observer, Task, observed


class Cancelled(Exception):
    """The user has pressed the button."""


class Progress(Observer):
    """Shows a share of the work, and stops it at the next step once `cancel` is set."""

    def __init__(self) -> None:
        self.cancel = threading.Event()  # set it from the thread of your user interface
        self.what, self.total, self.done = "", 0.0, 0.0

    @contextmanager
    def task(self, what: str, total: float | None, unit: str, done: float) -> Iterator[Task]:
        """Begin a piece of work; pieces may lie within each other."""
        outer = self.what, self.total, self.done
        self.what, self.total, self.done = what, total or 0.0, done
        yield self
        self.what, self.total, self.done = outer

    def advance(self, amount: float = 1) -> None:
        """Count, draw, and raise if the user has had enough: nothing is half done here."""
        if self.cancel.is_set():
            raise Cancelled(self.what)
        self.done += amount
        if self.total:
            self.draw(f"{self.what}: {min(1, self.done / self.total):.0%}")

    def note(self, text: str) -> None:
        """Take some words about the work, such as the loss."""

    def say(self, line: str) -> None:
        """Take a line that the user should read."""
        self.draw(line)

    def draw(self, text: str) -> None:
        """Replace this by your user interface."""
        print(text)


def main(scene: str, name: str, picture: str, output: str, progress: Progress) -> None:
    """Paint an object; without the last step's save, nothing on disk has changed."""
    with observed(progress):  # in this thread
        try:
            painted = ss.stylize(ss.open(scene), {name: ss.Style(picture, quality="draft")})
        except Cancelled as at:
            progress.draw(f"Cancelled while {at}.")
            return
        ss.save(painted, output)


if __name__ == "__main__":
    main(*sys.argv[1:], progress=Progress())

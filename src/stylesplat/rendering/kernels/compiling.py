"""A word to the user while kernels compile: once per machine and version, then they are cached."""

import sys
from functools import lru_cache

from numba.core import event

LINE = (
    "Compiling the CPU kernels for this processor. It takes up to half a minute, once: "
    "later starts find them in the cache."
)


class _Announcement(event.Listener):
    """Prints a line when the first compilation of the process begins."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, event: event.Event) -> None:
        """Called before each compilation, but not when a kernel is loaded from the cache."""
        if not self.said:
            print(LINE, file=sys.stderr)
            self.said = True

    def on_end(self, event: event.Event) -> None:
        """Nothing is said."""


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Print one line on stderr if kernels have to be compiled from now on."""
    event.register("numba:compile", _Announcement())

"""A word to the user while kernels compile: once per machine and version, then they are cached."""

from functools import lru_cache

from numba.core import event

from stylesplat.progress import say
from stylesplat.rendering.kernels.code_cache import NOWHERE, said

LINE = "Compiling the CPU kernels for this processor. It takes up to half a minute"
ONCE = f"{LINE}, once: later starts find them in the cache."


class _Announcement(event.Listener):
    """Says a line when the first compilation of the process begins."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, event: event.Event) -> None:
        """Called before each compilation, but not when a kernel is loaded from the cache."""
        if not self.said:
            say(f"{LINE}." if NOWHERE in said else ONCE)
            self.said = True

    def on_end(self, event: event.Event) -> None:
        """Nothing is said."""


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Say so in one line if kernels have to be compiled from now on."""
    event.register("numba:compile", _Announcement())

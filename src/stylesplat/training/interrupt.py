"""Ctrl-C and SIGTERM that wait for the end of a step, so that what is saved is consistent."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stylesplat.signals import TAKEN


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Within the block Ctrl-C and SIGTERM do nothing; the yielded function says if one came.

    Behind it they do what they would have done. Outside the main thread, where Python lets nobody
    handle signals, none comes; and who ignores one goes on doing so.
    """
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in TAKEN}
    if threading.current_thread() is threading.main_thread():
        taken = {n: h for n, h in handlers.items() if h not in (signal.SIG_IGN, None)}
    else:
        taken = {}
    try:
        for number in taken:
            signal.signal(number, lambda number, _: came.append(number))
        yield lambda: bool(came)
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)

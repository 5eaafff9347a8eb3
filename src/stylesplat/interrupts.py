"""Ctrl-C and SIGTERM set a flag, which `raise_if_interrupted` raises where nothing is half done.

So no signal lands in an import, in numba's compiler or in a library. All long work calls
`raise_if_interrupted`: `progress` does at every advance, `wait_until` while it waits. A second
signal ends the process at once. That is safe, because all output is written beside its place and
then renamed.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
POLL_SECONDS = 0.2
SAME_REQUEST = 2.0  # seconds: terminals, torchrun and batches may send one request twice
WHOLE = "Every file is as it was, or done."


class Interrupted(KeyboardInterrupt):
    """Ctrl-C."""

    number = signal.SIGINT


class Terminated(Interrupted):
    """SIGTERM, which batch systems, containers and spot machines send."""

    number = signal.SIGTERM


@dataclass
class _Flag:
    number: int | None = None  # of the signal that `raise_if_interrupted` has not raised yet
    first: float | None = None  # when the first signal came
    is_held: bool = False  # whether `raise_if_interrupted` raises nothing


_flag = _Flag()


def catch_signals() -> None:
    """Let Ctrl-C and SIGTERM set the flag. Signals that are ignored, as by `nohup`, stay so."""
    _flag.number = _flag.first = None
    for number in SIGNALS:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _set_flag)


def ignore_signals() -> None:
    """From now on ignore them: the work is done, and Python shuts down."""
    for number in SIGNALS:
        if signal.getsignal(number) is _set_flag:
            signal.signal(number, signal.SIG_IGN)


def raise_if_interrupted() -> None:
    """Raise Interrupted after Ctrl-C, Terminated after SIGTERM, once; in the main thread only."""
    if _flag.number is not None and not _flag.is_held and _in_main_thread():
        kind = Terminated if _flag.number == signal.SIGTERM else Interrupted
        _flag.number = None
        raise kind


def wait_until(has_ended: Callable[[float], object]) -> None:
    """Wait until a function is true that itself waits for some seconds, such as `Event.wait`."""
    while not has_ended(POLL_SECONDS):
        raise_if_interrupted()


@contextmanager
def held_signals() -> Iterator[Callable[[], bool]]:
    """Let signals wait for the end of the block; the function yielded says whether one came.

    Then they do what they would have done. Other threads get none, as Python has it.
    """
    if not _in_main_thread():
        yield lambda: False
        return
    taken = {number: signal.getsignal(number) for number in SIGNALS}
    taken = {n: h for n, h in taken.items() if h not in (signal.SIG_IGN, None, _set_flag)}
    _flag.is_held = True
    for number in taken:
        signal.signal(number, lambda number, _: setattr(_flag, "number", number))
    try:
        yield lambda: _flag.number is not None
    finally:
        _flag.is_held = False
        for number, handler in taken.items():
            signal.signal(number, handler)
        if (came := _flag.number) is not None and came in taken:
            _flag.number = None
            signal.raise_signal(came)
        raise_if_interrupted()


@contextmanager
def preserve_signal_handlers() -> Iterator[None]:
    """Let a library replace the handlers of signals within the block; restore them after it."""
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            with suppress(ValueError, TypeError):  # in a thread; or the handler is none of Python's
                signal.signal(number, handler)


def report_interruption(error: KeyboardInterrupt, advice: str = WHOLE) -> int:
    """Say in one line that a command was interrupted; return the exit status of shells."""
    number = getattr(error, "number", signal.SIGINT)
    print(_line(number, advice), end="", file=sys.stderr, flush=True)
    return 128 + number


def _line(number: int, advice: str) -> str:
    done = "terminated" if number == signal.SIGTERM else "interrupted"
    return f"stylesplat: {done}. {advice}\n"


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _set_flag(number: int, frame: FrameType | None) -> None:
    now = time.monotonic()
    if _flag.first is None:
        _flag.number, _flag.first = number, now
    elif now - _flag.first > SAME_REQUEST:
        with suppress(OSError):  # not by sys.stderr, which the signal may have interrupted
            os.write(2, f"\n{_line(number, WHOLE)}".encode())
        os._exit(128 + number)

"""Ctrl-C and SIGTERM raise exceptions in the command line, but never while a module is loaded."""

import _thread
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from stylesplat.stderr import write_lines

TAKEN = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 2.0  # seconds after a signal in which others only repeat it: clean-up goes on
AGAIN = 0.05  # seconds until a signal is tried again
FIRST = "stylesplat.io.atomic"  # what is loaded before a verb takes a lock or writes anything
WHOLE = "Every file is as it was, or done."


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems, containers and spot machines send."""


class _Last:
    """The last signal that was raised."""

    moment = -PATIENCE


def take_signals() -> None:
    """From now on raise KeyboardInterrupt at Ctrl-C and Terminated at SIGTERM, and lose neither.

    For the command line, whose process is its own. Signals that are ignored, as `nohup` and
    scripts wish for what they start, stay so.
    """
    for number in TAKEN:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _interrupt)
    sys.unraisablehook = _raise_again


def ignore_signals() -> None:
    """From now on let them pass: what was to be done is done, and Python shuts down."""
    for number in TAKEN:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_IGN)
    eval("None")  # else Python kills itself if Ctrl-C came while it ran a text, as dataclasses do


def told(error: KeyboardInterrupt, advice: str = WHOLE) -> int:
    """Say in one line that a command was interrupted; the exit status, as shells report it."""
    terminated = isinstance(error, Terminated)
    write_lines(f"stylesplat: {'terminated' if terminated else 'interrupted'}. {advice}")
    return 128 + (signal.SIGTERM if terminated else signal.SIGINT)


@contextmanager
def kept_signals() -> Iterator[None]:
    """Within the block a library may take signals; then Python's handlers are installed again."""
    handlers = {number: signal.getsignal(number) for number in TAKEN}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            with suppress(ValueError, TypeError):  # in a thread; or the handler is none of Python's
                signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if time.monotonic() - _Last.moment < PATIENCE:
        return
    error = Terminated() if number == signal.SIGTERM else KeyboardInterrupt()
    if _loads(frame):  # some modules crash if they are interrupted, or raise another error
        if FIRST not in sys.modules:
            os._exit(told(error))  # there is nothing to clean up
        _try_again(number)
        return
    _Last.moment = time.monotonic()
    raise error


def _loads(frame: FrameType | None) -> bool:
    """Whether a module is being loaded."""
    while frame and frame.f_globals.get("__name__") != "importlib._bootstrap":
        frame = frame.f_back
    return frame is not None


def _try_again(number: int) -> None:
    """Let a signal come once more, a moment later: the alarm also wakes who sleeps."""
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    else:
        signal.signal(signal.SIGALRM, lambda *_: _thread.interrupt_main(signal.Signals(number)))
        signal.setitimer(signal.ITIMER_REAL, AGAIN)


def _raise_again(unraisable: "sys.UnraisableHookArgs") -> None:
    """Python cannot raise in a `__del__`, or in what C has called."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        _Last.moment = -PATIENCE
        terminated = isinstance(unraisable.exc_value, Terminated)
        _try_again(signal.SIGTERM if terminated else signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)

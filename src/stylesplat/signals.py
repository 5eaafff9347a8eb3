"""Ctrl-C and SIGTERM raise exceptions in the command line, but never while a module is loaded."""

import _thread
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from stylesplat.progress import write_lines

TAKEN = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 2.0  # seconds after a signal in which others are ignored, so that clean-up goes on
AGAIN = 0.05  # seconds until a signal is tried again
FIRST = "stylesplat.cli.arguments"  # a module that is loaded before a verb writes anything
WHOLE = "Every file is as it was, or done."
_last_signal = [-PATIENCE]  # when it was raised


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems, containers and spot machines send."""


def take_signals() -> None:
    """From now on raise KeyboardInterrupt at Ctrl-C and Terminated at SIGTERM, and lose neither.

    Signals that are ignored, as by `nohup`, stay ignored.
    """
    for number in TAKEN:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _interrupt)
    sys.unraisablehook = _raise_again


def ignore_signals() -> None:
    """From now on ignore them: the work is done, and Python shuts down."""
    for number in TAKEN:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_IGN)


def report_interruption(error: KeyboardInterrupt, advice: str = WHOLE) -> int:
    """Say in one line that a command was interrupted; return the exit status of shells."""
    terminated = isinstance(error, Terminated)
    write_lines(f"stylesplat: {'terminated' if terminated else 'interrupted'}. {advice}")
    return 128 + (signal.SIGTERM if terminated else signal.SIGINT)


@contextmanager
def kept_signals() -> Iterator[None]:
    """Let a library replace the handlers of signals within the block; restore them after it."""
    handlers = {number: signal.getsignal(number) for number in TAKEN}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            with suppress(ValueError, TypeError):  # in a thread; or the handler is none of Python's
                signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if time.monotonic() - _last_signal[0] < PATIENCE:
        return
    error = Terminated() if number == signal.SIGTERM else KeyboardInterrupt()
    while frame and frame.f_globals.get("__name__") != "importlib._bootstrap":
        frame = frame.f_back
    if frame:  # a module is being loaded: some crash if they are interrupted
        if FIRST not in sys.modules:
            os._exit(report_interruption(error))  # there is nothing to clean up
        _try_again(number)
        return
    _last_signal[0] = time.monotonic()
    raise error


def _try_again(number: int) -> None:
    """Repeat a signal a moment later: the alarm also wakes a process that sleeps."""
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    else:
        signal.signal(signal.SIGALRM, lambda *_: _thread.interrupt_main(signal.Signals(number)))
        signal.setitimer(signal.ITIMER_REAL, AGAIN)


def _raise_again(unraisable: "sys.UnraisableHookArgs") -> None:
    """Python cannot raise in a `__del__`, or in what C has called."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
        return
    _last_signal[0] = -PATIENCE
    terminated = isinstance(unraisable.exc_value, Terminated)
    _try_again(signal.SIGTERM if terminated else signal.SIGINT)

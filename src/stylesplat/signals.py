"""Ctrl-C and SIGTERM raise exceptions in the command line, but not while a module is loaded."""

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from stylesplat.progress import write_lines

TAKEN = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 2.0  # seconds after a signal in which others are ignored, so that clean-up goes on
AGAIN = 0.05  # seconds until a signal is tried again
FIRST = "stylesplat.cli.arguments"  # a module that is loaded before a verb writes anything
UNINTERRUPTED = (  # what crashes if it is interrupted: modules that are loaded, kernels compiled
    "importlib._bootstrap",
    "numba.core.compiler_lock",
)
WHOLE = "Every file is as it was, or done."
_last_signal = [-PATIENCE]  # when it was raised


class Interrupted(KeyboardInterrupt):
    """Ctrl-C. If a library swallows the exception, the signal comes again: see `mark_handled`."""

    number = signal.SIGINT
    handled = False

    def __del__(self) -> None:
        if not self.handled:
            _last_signal[0] = -PATIENCE
            _try_again(self.number)


class Terminated(Interrupted):
    """SIGTERM, which batch systems, containers and spot machines send."""

    number = signal.SIGTERM


def take_signals() -> None:
    """From now on raise Interrupted at Ctrl-C and Terminated at SIGTERM, and lose neither.

    Signals that are ignored, as by `nohup`, stay ignored.
    """
    for number in TAKEN:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _interrupt)
    sys.unraisablehook = _report_unraisable


def ignore_signals() -> None:
    """From now on ignore them: the work is done, and Python shuts down."""
    if sys.platform != "win32":
        signal.setitimer(signal.ITIMER_REAL, 0)
    for number in TAKEN:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_IGN)


def report_interruption(error: KeyboardInterrupt, advice: str = WHOLE) -> int:
    """Say in one line that a command was interrupted; return the exit status of shells."""
    mark_handled(error)
    terminated = isinstance(error, Terminated)
    write_lines(f"stylesplat: {'terminated' if terminated else 'interrupted'}. {advice}")
    return 128 + (signal.SIGTERM if terminated else signal.SIGINT)


def mark_handled(error: KeyboardInterrupt) -> None:
    """Do not raise this interruption again when it is gone."""
    if isinstance(error, Interrupted):
        error.handled = True


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
    kind = Terminated if number == signal.SIGTERM else Interrupted
    while frame and frame.f_globals.get("__name__") not in UNINTERRUPTED:
        frame = frame.f_back
    if frame:
        if FIRST not in sys.modules:
            os._exit(report_interruption(kind()))  # there is nothing to clean up
        _try_again(number)
        return
    _last_signal[0] = time.monotonic()
    raise kind()  # in no local variable: its traceback would keep it alive


def _try_again(number: int) -> None:
    """Repeat a signal a moment later: the alarm also wakes a process that sleeps."""
    if signal.getsignal(number) is signal.SIG_IGN:
        return
    main = threading.main_thread()
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    elif threading.current_thread() is not main:  # where Python sets no handler
        signal.pthread_kill(main.ident or 0, number)
    else:
        signal.signal(signal.SIGALRM, lambda *_: _thread.interrupt_main(signal.Signals(number)))
        signal.setitimer(signal.ITIMER_REAL, AGAIN)


def _report_unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    """Python cannot raise in a `__del__`, or in what C has called; an interruption comes again."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)

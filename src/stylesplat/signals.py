"""Ctrl-C and SIGTERM: what they raise in the command line, and who else may take them."""

import _thread
import ctypes
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

TAKEN = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 2.0  # seconds after a signal in which others only repeat it: clean-up goes on
CRASHES = ("SIGSEGV", "SIGILL", "SIGFPE", "SIGABRT", "SIGBUS", "SIGTERM")  # that glog takes
ACTION_BYTES = 256  # room for a `struct sigaction`: 152 bytes on Linux, 16 on macOS
WHOLE = "Every file is as it was, or done."


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems, containers and spot machines send."""


class _Last:
    """The last signal of this process that was raised."""

    number: int | None = None
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


def interruption(error: BaseException) -> signal.Signals | None:
    """The signal that an error comes from, if it does.

    Modules that are interrupted while they are loaded raise any error.
    """
    if isinstance(error, Terminated):
        return signal.SIGTERM
    if isinstance(error, KeyboardInterrupt):
        return signal.SIGINT
    return None if _Last.number is None else signal.Signals(_Last.number)


def told(number: signal.Signals, advice: str = WHOLE) -> int:
    """Say in one line that a command was interrupted; the exit status, as shells report it."""
    what = "terminated" if number == signal.SIGTERM else "interrupted"
    print(f"stylesplat: {what}. {advice}", file=sys.stderr)
    return 128 + number


@contextmanager
def kept_signals() -> Iterator[None]:
    """Within the block a library may take signals; then they do what they did before.

    Handlers are kept as the system has them, for Python does not know those of C.
    """
    try:
        sigaction = ctypes.CDLL(None).sigaction
    except (AttributeError, OSError, TypeError):  # Windows
        yield
        return
    numbers = [getattr(signal, name) for name in CRASHES]
    actions = {number: ctypes.create_string_buffer(ACTION_BYTES) for number in numbers}
    for number, action in actions.items():
        sigaction(number, None, action)
    try:
        yield
    finally:
        for number, action in actions.items():
            sigaction(number, action, None)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if time.monotonic() - _Last.moment < PATIENCE:
        return
    _Last.number, _Last.moment = number, time.monotonic()
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _raise_again(unraisable: "UnraisableHookArgs") -> None:
    """Interrupt the main thread if Python cannot: in a `__del__`, or a callback from C."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        _Last.moment = -PATIENCE
        _thread.interrupt_main(interruption(unraisable.exc_value) or signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)

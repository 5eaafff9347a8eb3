"""Ctrl-C and SIGTERM: what they raise in the command line, and who else may take them."""

import _thread
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from stylesplat.stderr import write_lines

TAKEN = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 2.0  # seconds after a signal in which others only repeat it: clean-up goes on
LOADING = 10.0  # seconds for which a signal waits for a module: some crash if they are interrupted
FIRST = "stylesplat.io.locks"  # what is loaded before a verb takes a lock or writes anything
AGAIN = 0.05  # seconds until it is tried again
CRASHES = ("SIGSEGV", "SIGILL", "SIGFPE", "SIGABRT", "SIGBUS", "SIGTERM")  # that glog takes
ACTION_BYTES = 256  # room for a `struct sigaction`: 152 bytes on Linux, 16 on macOS
WHOLE = "Every file is as it was, or done."


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems, containers and spot machines send."""


class _Last:
    """The last signal of this process."""

    number: int | None = None
    moment = -PATIENCE  # when it came, or was raised
    waits = False  # to be raised
    others = 0  # libraries that may take signals now


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
    write_lines(f"stylesplat: {what}. {advice}")
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
        _Last.others += 1
        yield
    finally:
        for number, action in actions.items():
            sigaction(number, action, None)
        _Last.others -= 1


def _interrupt(number: int, frame: FrameType | None) -> None:
    now = time.monotonic()
    if not _Last.waits:
        if now - _Last.moment < PATIENCE:
            return
        _Last.number, _Last.moment = number, now
    if _loads(frame):
        if not _is_loaded(FIRST):
            os._exit(told(signal.Signals(number)))  # there is nothing to clean up
        if now - _Last.moment < LOADING:
            _try_again()
            return
    _Last.moment, _Last.waits = now, False
    raise Terminated if _Last.number == signal.SIGTERM else KeyboardInterrupt


def _loads(frame: FrameType | None) -> bool:
    """Whether a module is being loaded."""
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            return True
        frame = frame.f_back
    return False


def _is_loaded(name: str) -> bool:
    """Whether a module is there, and as a whole."""
    module = sys.modules.get(name)
    return module is not None and not getattr(module.__spec__, "_initializing", False)


def _try_again() -> None:
    """Let the last signal come once more, a moment later."""
    main = threading.main_thread().ident
    assert main, "it has begun"

    def come() -> None:
        time.sleep(AGAIN)
        while _Last.others > 0:  # one of them would end the process
            time.sleep(AGAIN)
        number = signal.Signals(_Last.number or signal.SIGINT)
        if sys.platform == "win32":
            _thread.interrupt_main(number)
        else:
            signal.pthread_kill(main, number)  # wakes it, should it wait

    _Last.waits = True
    _thread.start_new_thread(come, ())  # takes no lock that what is interrupted may hold


def _raise_again(unraisable: "sys.UnraisableHookArgs") -> None:
    """Python cannot raise in a `__del__`, or in what C has called."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        _try_again()
    else:
        sys.__unraisablehook__(unraisable)

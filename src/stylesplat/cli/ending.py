"""How a command ends that could not be done: one line on stderr, and an exit status."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import DISK_FULL, reason
from stylesplat.signals import WHOLE, told
from stylesplat.stderr import write_lines

AT_FAULT = 1  # the user's input, or a machine that is too small for it
PIPE_CLOSED = 141  # what shells report of programs that nobody listens to any more
# What torch, OpenCV and CUDA say in errors of many kinds
NO_MEMORY = ("allocate memory", "not enough memory", "out of memory", "insufficient memory")
OUT_OF_MEMORY = (
    "Out of memory. Close other programs, or work on less: smaller photos, fewer views or fewer "
    "Gaussians."
)
BUG = "This is a mistake in stylesplat. Please report it, with all these lines."


def status_after(error: BaseException, advice: Callable[[], str] = lambda: WHOLE) -> int | None:
    """Say what stopped a command, and what to do about it.

    Args:
        error: What it raised.
        advice: Says how to go on after Ctrl-C; not asked otherwise.

    Returns:
        The exit status; None if nobody knows what to do, for then it is a bug.
    """
    if isinstance(error, KeyboardInterrupt):
        return told(error, advice())
    if isinstance(error, BrokenPipeError):
        _listen_no_more()
        return PIPE_CLOSED
    line = line_of(error)
    if line is None:
        error.add_note(BUG)
        return None
    write_lines(f"stylesplat: {line}")
    return AT_FAULT


def line_of(error: BaseException) -> str | None:
    """The fact and the remedy, of what can be mended; None of what is a bug."""
    if isinstance(error, StyleSplatError):
        return str(error)
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        return f"Disk full{_place(error)}. Free some space and try again."
    said = str(error).lower()
    if isinstance(error, MemoryError) or any(words in said for words in NO_MEMORY):
        return OUT_OF_MEMORY
    if isinstance(error, OSError):
        return f"{error.strerror or reason(error)}{_place(error)}. Mend that and try again."
    return None


def _place(error: OSError) -> str:
    return f": {error.filename}" if error.filename else ""


def _listen_no_more() -> None:
    """Let Python write what is left to nowhere, for it would complain."""
    with Path(os.devnull).open("wb") as nowhere:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                os.dup2(nowhere.fileno(), stream.fileno())

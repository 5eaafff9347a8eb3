"""How a command ends that failed: one line on stderr, and an exit status."""

import os
import sys
from contextlib import suppress
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import DISK_FULL, reason
from stylesplat.progress import write_lines
from stylesplat.signals import WHOLE, report_interruption

AT_FAULT = 1  # the user's input, or a machine that is too small for it
PIPE_CLOSED = 141  # as shells report it, after `| head`
# Words of torch, OpenCV and CUDA, in errors of many kinds
NO_MEMORY = ("allocate memory", "not enough memory", "out of memory", "insufficient memory")
OUT_OF_MEMORY = (
    "Out of memory. Close other programs, or work on less: smaller photos, fewer views or fewer "
    "Gaussians."
)
BUG = "This is a mistake in stylesplat. Please report it, with all these lines."


def exit_status(error: BaseException, command: object = None) -> int | None:
    """Say why a command failed, and what to do about it; return None if the error is a bug.

    After Ctrl-C the command's `after_interruption` says how to continue.
    """
    if isinstance(error, KeyboardInterrupt):
        return report_interruption(error, getattr(command, "after_interruption", WHOLE))
    if isinstance(error, BrokenPipeError):
        with Path(os.devnull).open("wb") as nowhere:  # for what Python still writes at its end
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    os.dup2(nowhere.fileno(), stream.fileno())
        return PIPE_CLOSED
    line = user_message(error)
    if line is None:
        error.add_note(BUG)
        return None
    write_lines(f"stylesplat: {line}")
    return AT_FAULT


def user_message(error: BaseException) -> str | None:
    """The fact and the remedy; None if the user can do nothing about the error."""
    if isinstance(error, StyleSplatError):
        return str(error)
    text = str(error).lower()
    full = isinstance(error, OSError) and error.errno in DISK_FULL
    if not full and (isinstance(error, MemoryError) or any(words in text for words in NO_MEMORY)):
        return OUT_OF_MEMORY
    if not isinstance(error, OSError):
        return None
    place = f": {error.filename}" if error.filename else ""
    if full:
        return f"Disk full{place}. Free some space and try again."
    return f"{error.strerror or reason(error)}{place}. Mend that and try again."

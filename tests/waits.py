"""Waits for what other processes do, each with a limit."""

import subprocess
import time
from collections.abc import Callable

LIMIT = 120.0  # seconds: machines that build this are slow at times


def wait_until(
    reached: Callable[[], object],
    process: subprocess.Popen,
    said: Callable[[], object] = lambda: "",
) -> None:
    """Wait for a process to come that far; if it ends or takes too long, that fails and ends it."""
    last = time.monotonic() + LIMIT
    try:
        while not reached():
            assert process.poll() is None, f"it ended before: {said()}"
            assert time.monotonic() < last, f"it takes too long: {said()}"
            time.sleep(0.02)
    except BaseException:
        process.kill()
        process.wait(timeout=60)
        raise

"""Pages that are served until Ctrl-C."""

import sys
from collections.abc import Callable
from io import StringIO
from typing import NoReturn


def serve(start: Callable[[], Callable[[], None]], hint: str) -> NoReturn:
    """Start a server, say something, and wait for Ctrl-C.

    Args:
        start: Starts it, and gives what stops it.
        hint: What to say then.
    """
    from stylesplat.drawing.browser import until_interrupted
    from stylesplat.progress import say

    sys.stdout = sys.stderr  # viser says where it serves
    stop = start()
    sys.stdout = StringIO()  # and its thread, after our last line, that it no longer does
    say(hint)
    until_interrupted(stop)

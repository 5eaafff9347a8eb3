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
    from stylesplat.figures.browser import until_interrupted
    from stylesplat.progress import say

    stop = start()
    sys.stdout = StringIO()  # viser's thread says, after our last line, that it no longer serves
    say(hint)
    until_interrupted(stop)

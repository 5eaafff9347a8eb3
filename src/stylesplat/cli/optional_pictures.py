"""Pictures of what is saved already: without them a command has done its work all the same."""

from collections.abc import Iterator
from contextlib import contextmanager

from stylesplat.cli.ending import line_of
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.progress import say

FAULTS = (StyleSplatError, MemoryError, RuntimeError, OSError)  # CUDA's are RuntimeErrors


@contextmanager
def told_if_missing(of: str = "") -> Iterator[None]:
    """Within the block a picture is drawn; if that fails it is said, and no failure.

    Args:
        of: What it would show, if that is not clear.
    """
    try:
        yield
    except FAULTS as error:
        what = f"There is no picture of {of}" if of else "There is no picture"
        say(f"{what}: {line_of(error) or reason(error)}")

"""The one exception that users are meant to read."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

# Control characters, line ends, halves of characters: names in files can have them
UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


class StyleSplatError(Exception):
    """Something the user can fix.

    The message is one line: the call, the fact, the remedy. The command line prints it
    without a traceback and exits with status 1.

    Example:
        >>> print(StyleSplatError("There is no picture a\\nb.png. Check the name."))
        There is no picture a\\nb.png. Check the name.
    """

    def __init__(self, message: str) -> None:
        super().__init__(UNPRINTABLE.sub(lambda found: ascii(found[0])[1:-1], message))


def check_choice(value: object, what: str, choices: Iterable[object]) -> None:
    """Raise a StyleSplatError unless a value is one of some."""
    known = [*choices]
    if value not in known:
        raise StyleSplatError(f"There is no {what} {value!r}. Use {', '.join(map(str, known))}.")


@contextmanager
def within(place: str) -> Iterator[None]:
    """Make errors say where they occurred."""
    try:
        yield
    except StyleSplatError as error:
        raise StyleSplatError(f"{place}: {error}") from error
    except OSError as error:
        raise StyleSplatError(f"{place}: {error.strerror}: {error.filename}.") from error

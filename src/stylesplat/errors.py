"""The one exception that users are meant to read."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class StyleSplatError(Exception):
    """Something the user can fix.

    The message is one line: the call, the fact, the remedy. The command line prints it
    without a traceback and exits with status 1.
    """


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

"""The exception whose message users read, and the words of messages."""

import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

HEAD, TAIL = 1200, 600  # characters of a very long message that are kept
LONGEST_NAME = 100  # characters of a name in a message
JOINED_NAMES = 3  # names in a message; the others are counted
UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]+")


class StyleSplatError(Exception):
    """An error that the user can fix.

    The message is one line: the call, the fact, the remedy. The command line prints it without a
    traceback and exits with status 1. Line ends, control characters and pages of text, which names
    and values of files may bring, are removed.
    """

    def __init__(self, message: str) -> None:
        line = printable(message).strip()
        cut = f"{line[:HEAD]} ... {line[-TAIL:]}" if len(line) > HEAD + TAIL else line
        super().__init__(cut)


def check_choice(value: object, what: str, choices: Iterable[object]) -> None:
    """Raise a StyleSplatError unless a value is one of the choices."""
    known = [*choices]
    if value not in known:
        raise StyleSplatError(f"There is no {what} {value!r}. Use {', '.join(map(str, known))}.")


def printable(text: str) -> str:
    """A text in one line, without characters that a terminal would not show."""
    return UNPRINTABLE.sub(" ", text)


def shorten(name: str) -> str:
    """A name, shortened if it is too long for a message."""
    return name if len(name) <= LONGEST_NAME else f"{name[:20]}..."


def join_names(names: Iterable[object], most: int = JOINED_NAMES, *, whole: bool = False) -> str:
    """The first names, and how many others there are; `whole` keeps long names, as paths to type.

    Example:
        >>> join_names("abc"), join_names("abcde"), join_names("")
        ('a, b, c', 'a, b, c and 2 more', '')
    """
    several = [printable(str(name) if whole else shorten(str(name))) for name in names]
    others = f" and {len(several) - most} more" if len(several) > most else ""
    return ", ".join(several[:most]) + others


@contextmanager
def error_context(place: str) -> Iterator[None]:
    """Put the place where errors occur before their messages."""
    try:
        yield
    except StyleSplatError as error:
        raise StyleSplatError(f"{place}: {error}") from error
    except OSError as error:
        raise StyleSplatError(f"{place}: {error.strerror}: {error.filename}.") from error


def noun_repr(noun: object, *parts: object) -> str:
    """The one-line representation of a noun, made without reading a photo."""
    texts = (printable(str(part)) for part in parts if part is not None)
    return f"{type(noun).__name__}({', '.join(filter(None, texts))})"


def count_noun(count: int, what: str) -> str:
    """A number and its noun, such as '1 photo' or '60,000 Gaussians'."""
    return f"{count:,} {what}{'s' * (count != 1)}"


def format_duration(seconds: float) -> str:
    """A duration in a unit that suits it.

    Example:
        >>> format_duration(99.0), format_duration(600.0), format_duration(9000.0)
        ('99 s', '10 min', '2.5 h')
    """
    if seconds < 180:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def shell_command(verb: str, *arguments: object) -> str:
    """A command for the shell, its arguments quoted where necessary."""
    return shlex.join(["stylesplat", verb, *map(str, arguments)])

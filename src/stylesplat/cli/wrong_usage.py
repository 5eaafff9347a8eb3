"""What is wrong with words that no command could be read from, in one line."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

OPTION = re.compile(r"--?[A-Za-z]")  # how options begin, and no number or path does


class WrongUsage(Exception):
    """Words that make no command; the line says which, and what is expected."""


@dataclass(frozen=True)
class Known:
    """An option, or a place for a word without one."""

    names: tuple[str, ...]
    """As they are typed; of a place, its placeholder."""
    placeholder: str
    """What stands for its values."""
    expected: str
    """What its values are."""
    count: int | Literal["*"]
    """How many values it takes at a time."""
    required: bool

    @property
    def is_place(self) -> bool:
        """Whether it has no name to type."""
        return not self.names[0].startswith("-")

    @property
    def call(self) -> str:
        """How it is typed."""
        return self.names[0] if self.is_place else f"{self.names[0]} {self.placeholder}"


@dataclass
class _Read:
    """What could be read of the words."""

    given: list[Known] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    """Those that belong to no option."""
    unknown: list[str] = field(default_factory=list)
    miscounted: list[str] = field(default_factory=list)
    """Lines about options with too few values, or too many."""


def what_is_wrong(known: Sequence[Known], arguments: Sequence[str], prog: str) -> str:
    """Why words are refused, in the order in which one fault explains the next.

    Args:
        known: All that the command takes.
        arguments: What was typed after the verb, which the parser refused.
        prog: The words before it.
    """
    read = _read(known, arguments)
    if read.unknown:
        return _unknown(read.unknown[0], known)
    if read.miscounted:
        return read.miscounted[0]
    places = [each for each in known if each.is_place]
    if len(read.words) > len(places) and not any(each.count == "*" for each in places):
        extra = read.words[len(places)]
        return f"there is no place for {extra!r}; a name with spaces needs quotes."
    there = [*read.given, *places[: len(read.words)]]
    needed = [each for each in known if each.required]
    missing = [each.names[0] for each in needed if each not in there]
    if not missing:
        return "the words make no command."
    *others, last = missing
    calls = " ".join(each.call for each in needed)
    are = f"{', '.join(others)} and {last} are" if others else f"{last} is"
    return f"{are} missing in `{prog} {calls}`."


def _read(known: Sequence[Known], arguments: Sequence[str]) -> _Read:
    options = {name: each for each in known for name in each.names if not each.is_place}
    read, rest = _Read(), [*arguments]
    while rest:
        word = rest.pop(0)
        name, equals, value = word.partition("=")
        if word == "--":
            read.words += rest
            break
        if not OPTION.match(word):
            read.words.append(word)
        elif (option := _called(name, options)) is None:
            read.unknown.append(name)
        else:
            attached = [value] if equals or name not in options else []
            _take(option, attached, rest, read)
    return read


def _called(name: str, options: dict[str, Known]) -> Known | None:
    """The option of a name, which underscores spell as well; `-oPATH` is one word."""
    spelled = name.replace("_", "-")
    return options.get(spelled) or (None if name[1] == "-" else options.get(name[:2]))


def _take(option: Known, attached: list[str], rest: list[str], read: _Read) -> None:
    """Take an option's values off the rest."""
    read.given.append(option)
    values = list(attached)
    while rest and (option.count == "*" or len(values) < option.count):
        if OPTION.match(rest[0]) or rest[0] == "--":
            break
        values.append(rest.pop(0))
    name, count, got = option.names[-1], option.count, len(values)
    if count == 0 and attached:
        read.miscounted.append(f"{name} takes no value, got {attached[0]!r}.")
    elif count == 1 and not got:
        read.miscounted.append(f"{name}: expected {option.expected}, got nothing.")
    elif count != "*" and got < count:
        read.miscounted.append(f"{name}: expected {count} values, got {got}.")


def _unknown(name: str, known: Sequence[Known]) -> str:
    from difflib import get_close_matches

    names = [name for each in known for name in each.names if not each.is_place]
    close = get_close_matches(name.replace("_", "-"), names, n=1, cutoff=0.7)
    return f"there is no option {name}." + (f" Is it {close[0]}?" if close else "")

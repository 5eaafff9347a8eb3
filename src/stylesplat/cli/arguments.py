"""From a command's dataclass to its options, their help and their values.

A command's fields are its options, the strings under them their help. Positional arguments,
required options and those that the command names in `first` come first in its help, all others
under 'more options'. An option that holds a tuple of any length may be repeated, and appends.
"""

import ast
import dataclasses
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from itertools import chain
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

import tyro
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec

from stylesplat.cli.wrong_usage import Known, WrongUsage, what_is_wrong

FIRST = "first"  # the class variable of commands that names options
MORE = "more"  # tyro calls the group of what is nested here 'more options'
TRAILING = re.compile(r" +$", re.MULTILINE)
EMPTY_ROW = re.compile(r"^\n(?=  )", re.MULTILINE)  # tyro's, after a text that fills its line
# What values are called: as placeholders, and where one is wrong
CALLED = {
    Path: ("PATH", "a path"),
    str: ("TEXT", "a text"),
    int: ("N", "a whole number"),
    float: ("NUMBER", "a number"),
}


def read_command(command: type, arguments: Sequence[str], prog: str) -> Any:
    """A command with what the user typed.

    Raises:
        WrongUsage: If the words make no command.
        SystemExit: After help.
    """
    try:
        with _tidied(), redirect_stderr(StringIO()):
            parsed = tyro.cli(understood(command), prog=prog, args=arguments)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise WrongUsage(what_is_wrong(known(command), arguments, prog)) from None
    given = vars(parsed)
    given |= vars(given.pop(MORE, None) or parsed)
    return command(**{f.name: _joined(f, given[f.name]) for f in dataclasses.fields(command)})


@contextmanager
def _tidied() -> Iterator[None]:
    """Print help in one colour, without the rows and spaces that are left empty."""
    page = StringIO()
    try:
        with redirect_stdout(page):
            yield
    finally:
        lines = EMPTY_ROW.sub("", TRAILING.sub("", page.getvalue())).splitlines(keepends=True)
        if lines:  # even nothing cannot be written to a full disk
            sys.stdout.write("".join(map(_filled, lines)))


def _filled(line: str) -> str:
    """A line of prose as wide as the terminal; examples are to be copied, tyro fills the rest."""
    columns = get_terminal_size().columns
    if len(line) <= columns or line.startswith(("Example:", "usage:")):
        return line
    return fill(line, columns) + "\n"


def understood(command: type, *, choices: bool = False) -> type:
    """What tyro sees of a command.

    Args:
        command: The dataclass.
        choices: Tell tyro the values that an option can take, for shells to complete; its own
            message about others would be Python's.
    """
    said = _docstrings(command)
    shown: tuple[list[Any], list[Any]] = [], []
    for field in dataclasses.fields(command):
        option = field.name, _option(field, said.get(field.name), choices=choices), _default(field)
        shown[not _comes_first(command, field)].append(option)
    first, more = shown
    if more:
        nested = dataclasses.make_dataclass("More", more, kw_only=True, namespace={"__doc__": ""})
        default = dataclasses.field(default_factory=nested)
        first.append((MORE, OmitArgPrefixes[nested], default))
    words = {"__doc__": inspect.getdoc(command)}
    return dataclasses.make_dataclass(command.__name__, first, kw_only=True, namespace=words)


def known(command: type) -> list[Known]:
    """The options of a command, for a line about words that it cannot take."""
    return [_known(field) for field in dataclasses.fields(command)]


def _known(field: "dataclasses.Field[Any]") -> Known:
    kind, markers = _plain(field.type)
    flag = _flag(field, markers)
    aliases = (getattr(marker, "aliases", None) for marker in markers if marker is not Positional)
    names = (*chain.from_iterable(filter(None, aliases)), flag)
    required = field.default is dataclasses.MISSING
    if kind is bool:
        return Known(names, "", "", 0, required)
    if UseAppendAction in markers:
        kind = get_args(kind)[0]
    each, number = _each(kind)
    return Known(names, *_called(each), number, required)


def _comes_first(command: type, field: "dataclasses.Field[Any]") -> bool:
    required = field.default is dataclasses.MISSING
    named = field.name in getattr(command, FIRST, ())
    return required or named or Positional in get_args(field.type)[1:]


def _default(field: "dataclasses.Field[Any]") -> Any:
    """The default of an option, to which nothing is appended."""
    return dataclasses.field(default=() if _is_open(_plain(field.type)[0]) else field.default)


def _option(field: "dataclasses.Field[Any]", said: str | None, *, choices: bool) -> Any:
    """The type of an option, with all that tyro shall know of it."""
    kind, markers = _plain(field.type)
    name = _flag(field, markers)
    config = arg(help=said, help_behavior_hint=_hint(field.default))
    if kind is bool:
        return Annotated[(bool, config, *markers)]
    if not _is_open(kind):
        return Annotated[(kind | None, _spec(kind, name, choices=choices), config, *markers)]
    if Positional in markers:
        return Annotated[(kind, _spec(kind, name, choices=choices), config, *markers)]
    several = UseAppendAction not in markers  # of them at a time
    element = kind if several else get_args(kind)[0]
    each = Annotated[element, _spec(element, name, choices=choices)]
    return Annotated[(tuple[each, ...], config, UseAppendAction, *markers)]


def _plain(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without None, and what it is annotated with."""
    markers: tuple[Any, ...] = ()
    if get_origin(kind) is Annotated:
        kind, *rest = get_args(kind)
        markers = tuple(rest)
    if NoneType in get_args(kind):
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    return kind, markers


def _flag(field: "dataclasses.Field[Any]", markers: tuple[Any, ...]) -> str:
    """What messages call an option."""
    given = (getattr(marker, "name", None) for marker in markers if marker is not Positional)
    name = next(filter(None, given), field.name).replace("_", "-")
    return name.upper() if Positional in markers else f"--{name}"


def _is_open(kind: Any) -> bool:
    """Whether values of a type are tuples of any length."""
    return get_origin(kind) is tuple and Ellipsis in get_args(kind)


def _hint(default: Any) -> str:
    """What help says of a default that its text does not."""
    plain = default is dataclasses.MISSING or default in (None, ()) or isinstance(default, bool)
    return "" if plain else f"(default: {default})"


def _spec(kind: Any, name: str, *, choices: bool) -> PrimitiveConstructorSpec[Any]:
    """How texts become a value of a type."""
    each, number = _each(kind)
    placeholder, expected = _called(each)
    convert = _converter(each)
    if name[0] != "-":
        placeholder = name
    metavar = {"*": f"{placeholder} [{placeholder} ...]", 1: placeholder}.get(number)

    def value_of(texts: list[str]) -> Any:
        try:
            values = tuple(convert(text) for text in texts)
        except ValueError:
            got = " ".join(texts)
            raise WrongUsage(f"{name}: expected {expected}, got {got!r}.") from None
        if not values:
            raise WrongUsage(f"{name}: expected {expected}, got nothing.")
        return values[0] if number == 1 else values

    return PrimitiveConstructorSpec(
        nargs=number,
        metavar=metavar or " ".join([placeholder] * int(number)),
        instance_from_str=value_of,
        is_instance=lambda value: True,
        str_from_instance=lambda value: [str(value)],
        choices=tuple(map(str, get_args(each)))
        if choices and get_origin(each) is Literal
        else None,
    )


def _each(kind: Any) -> tuple[Any, int | Literal["*"]]:
    """What one text of a value is, and how many there are."""
    if get_origin(kind) is not tuple:
        return kind, 1
    kinds = get_args(kind)
    return kinds[0], "*" if Ellipsis in kinds else len(kinds)


def _called(kind: Any) -> tuple[str, str]:
    """The placeholder of a value, and what is expected in its place."""
    if get_origin(kind) is not Literal:
        return CALLED[kind]
    *others, last = choices = [*map(str, get_args(kind))]
    return f"{{{','.join(choices)}}}", f"{', '.join(others)} or {last}"


def _converter(kind: Any) -> Callable[[str], Any]:
    if get_origin(kind) is not Literal:
        return kind
    choices = [*map(str, get_args(kind))]
    return lambda text: get_args(kind)[choices.index(text)]


def _joined(field: "dataclasses.Field[Any]", value: Any) -> Any:
    """The value of a field, of what was given for its option."""
    kind, markers = _plain(field.type)
    if not _is_open(kind):
        return value
    if UseAppendAction not in markers and Positional not in markers:
        value = tuple(each for several in value for each in several)
    return value or field.default


def _docstrings(command: type) -> dict[str, str]:
    """The string under each field, without its line breaks."""
    said: dict[str, str] = {}
    for each in reversed(command.__mro__[:-1]):
        (body,) = ast.parse(inspect.cleandoc("\n" + inspect.getsource(each))).body
        assert isinstance(body, ast.ClassDef)
        for before, after in zip(body.body, body.body[1:], strict=False):
            if not isinstance(before, ast.AnnAssign) or not isinstance(after, ast.Expr):
                continue
            assert isinstance(before.target, ast.Name)
            text = ast.literal_eval(after.value)
            said[before.target.id] = " ".join(text.split())
    return said

"""From the dataclass of a command to its options, by tyro.

The fields of a command are its options, and the strings under them their help. Settings of a stage
are declared in the stage's config only: a command takes them by `from_config`.
"""

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import MISSING, fields, is_dataclass
from functools import reduce
from importlib.metadata import version
from inspect import getdoc
from io import StringIO
from operator import or_
from types import NoneType
from typing import Annotated, Any, TypedDict, get_args, get_type_hints, is_typeddict

import tyro
from docstring_parser import parse_from_object
from tyro.conf import DisallowNone, OmitArgPrefixes, PositionalMetavarFromFieldName, arg, subcommand
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

PROGRAM = "stylesplat"
WRONG_USAGE = 2
ALIASES = {"stylize": ("stylise",)}
REGISTRY = ConstructorRegistry()
LOOK = (DisallowNone, PositionalMetavarFromFieldName)
WIDE = "10000"  # columns in which tyro wraps no error
FRAME = "│╭╮╰╯─ "
DETAILS = " " * 8  # in front of the help of single options, in errors
ENDS = ("Argument helptext", "Got errors", "For full helptext")  # what a user need not read
WAY = """\
Repaint chosen objects of a 3D Gaussian splat in the style of any picture.

From photos to a painted splat:

  stylesplat mask MyPhotos --box vase=1.jpg:500,300,800,700  where the vase is
  stylesplat train MyPhotos -o scene                         photos to a splat
  stylesplat stylize scene --style vase=wave.jpg -o painted  the vase in a style
  stylesplat view painted                                    look at it
  stylesplat export painted painted.ply                      for other programs

`stylesplat VERB --help` explains a verb.
"""


class WrongUsage(Exception):
    """Arguments that tyro does not understand; the message is one line."""

    def __init__(self, prog: str, fact: str) -> None:
        super().__init__(f"{prog}: {fact}. See `{prog} --help`.")
        self.fact = fact


def help_texts(config: type) -> dict[str, str]:
    """The first paragraphs of the strings under the fields of a dataclass."""
    texts = {each.arg_name: each.description or "" for each in parse_from_object(config).params}
    return {name: " ".join(text.partition("\n\n")[0].split()) for name, text in texts.items()}


def from_config(config: type, *names: str, **called: Sequence[str]) -> Any:
    """Annotates a dict as settings of a config, which holds only those that the user gave.

    Args:
        config: Declares their types, defaults and help.
        names: Which of them are options.
        called: Other names of options, by setting; the first is the one that help shows.
    """
    kinds, texts, defaults, options = get_type_hints(config), help_texts(config), config(), {}
    for name in names:
        default = getattr(defaults, name)
        shown, *aliases = called.get(name, (name,))
        options[name] = Annotated[
            without_none(kinds[name]),
            arg(
                name=shown,
                aliases=[f"--{each}" for each in aliases],
                help=texts[name],
                help_behavior_hint="" if default is None else f"(default: {default})",
            ),
        ]
    return TypedDict(config.__name__, options, total=False)  # pyright: ignore


def without_none(kind: Any) -> Any:
    """The type T of `T | None`, or the type itself."""
    types = [each for each in get_args(kind) if each is not NoneType]
    return types[0] if NoneType in get_args(kind) else kind


@REGISTRY.struct_rule
def _command(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Read a dataclass as tyro does, but join the lines of help, hide defaults such as None, and
    put the options that all verbs share last.
    """
    if not is_dataclass(info.type) or info.type.__module__.startswith("tyro"):
        return None
    kinds, texts = get_type_hints(info.type, include_extras=True), help_texts(info.type)
    options = []
    for each in sorted(fields(info.type), key=lambda each: bool(each.kw_only)):
        kind: Any = kinds[each.name]
        default = tyro.MISSING_NONPROP if each.default is MISSING else each.default
        if default in (None, ()) or isinstance(default, bool):
            kind = Annotated[kind, arg(help_behavior_hint="")]
        settings = next(filter(is_typeddict, get_args(kind)), None)
        if settings is not None:
            kind, default = OmitArgPrefixes[settings], {}
        options.append(StructFieldSpec(each.name, kind, default, texts.get(each.name)))
    return StructConstructorSpec(info.type, tuple(options))


def read_arguments(verbs: Mapping[str, type], arguments: Sequence[str]) -> Any:
    """The command that the user typed.

    Raises:
        WrongUsage: If tyro does not understand the arguments.
        SystemExit: After help, version or completion (0); or after help if there is no verb (2).
    """
    name = arguments[0] if arguments else ""
    verb = next((each for each in verbs if name in (each, *ALIASES.get(each, ()))), None)
    if verb is not None:
        return read_command(verbs[verb], arguments[1:], f"{PROGRAM} {verb}")
    if name == "--version":
        print(PROGRAM, version(PROGRAM))
        raise SystemExit
    commands = reduce(or_, (_subcommand(name, command) for name, command in verbs.items()))
    if name:
        return read_command(commands, arguments, PROGRAM, description=WAY)
    try:
        with redirect_stdout(sys.stderr):
            return read_command(commands, ["--help"], PROGRAM, description=WAY)
    except SystemExit:
        raise SystemExit(WRONG_USAGE) from None


def read_command(kind: Any, words: Sequence[str], prog: str, **options: Any) -> Any:
    """A command, or one of a union of commands, with the options in the words after `prog`."""
    options |= {"prog": prog, "args": words, "config": LOOK, "registry": REGISTRY}
    if not {"-h", "--help"}.isdisjoint(words):
        return tyro.cli(kind, **options)
    box = StringIO()
    try:
        with redirect_stderr(box), _wide_terminal():
            return tyro.cli(kind, **options)
    except SystemExit as stop:
        if stop.code:
            raise WrongUsage(prog, _one_line(box.getvalue())) from None
        raise


def _subcommand(name: str, command: type) -> Any:
    summary = (getdoc(command) or "").partition("\n")[0]
    aliases = ALIASES.get(name)
    return Annotated[command, subcommand(name, description=summary, aliases=aliases)]


@contextmanager
def _wide_terminal() -> Iterator[None]:
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = WIDE
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before


def _one_line(box: str) -> str:
    """The error in tyro's box, without its frame and title, and without the help of options."""
    rows = [row.strip("│").removeprefix(" ").rstrip() for row in box.splitlines()[1:]]
    line = ""
    for row in rows:
        text = row.strip(FRAME)
        if text.startswith(ENDS):
            break
        if text and not row.startswith(DETAILS):
            line += text + (" " if text.endswith(":") else "; ")
    return line.strip(".; ")

"""What the command line says of itself: the way through, the verbs, the version."""

import sys
from collections.abc import Mapping, Sequence
from inspect import getdoc
from shutil import get_terminal_size
from textwrap import fill
from typing import Any, NoReturn

from stylesplat.cli.arguments import read_command, understood
from stylesplat.cli.wrong_usage import WrongUsage
from stylesplat.stderr import write_lines

PROGRAM = "stylesplat"
ALIASES = {"stylise": "stylize"}
COMPLETION = ("--tyro-print-completion", "--tyro-write-completion")
WRONG_USAGE = 2
WAY = """\
Repaint chosen objects of a 3D Gaussian splat in the style of any picture.

From photos to a painted splat:

  stylesplat mask MyPhotos --box vase=1.jpg:500,300,800,700  where the vase is
  stylesplat train MyPhotos -o scene                         photos to a splat
  stylesplat stylize scene --style vase=wave.jpg -o painted  the vase in a style
  stylesplat view painted                                    look at it
  stylesplat export painted painted.ply                      for other programs
"""
ENDING = """\
`stylesplat VERB --help` explains a verb.
"""


def read(verbs: Mapping[str, type], arguments: Sequence[str]) -> Any:
    """The command that the user typed.

    Raises:
        SystemExit: After help, version or completion (0), or a line about wrong usage (2).
    """
    first = arguments[0] if arguments else ""
    verb = ALIASES.get(first, first)
    if first in ("-h", "--help"):
        print(_overview(verbs), end="")
        raise SystemExit
    if first == "--version":
        _say_version()
    if first in COMPLETION:
        _complete(verbs, arguments)
    if not first:
        print(_overview(verbs), end="", file=sys.stderr)
        raise SystemExit(WRONG_USAGE)
    if verb not in verbs:
        _refuse(f"there is no verb {first!r}.{_meant(first, verbs)}", "")
    try:
        return read_command(verbs[verb], arguments[1:], f"{PROGRAM} {verb}")
    except WrongUsage as error:
        _refuse(str(error), f" {verb}")


def _refuse(line: str, verb: str) -> NoReturn:
    write_lines(f"{PROGRAM}{verb}: {line} See `{PROGRAM}{verb} --help`.")
    raise SystemExit(WRONG_USAGE)


def _meant(word: str, verbs: Mapping[str, type]) -> str:
    """A guess at the verb of a word."""
    from difflib import get_close_matches

    close = get_close_matches(word, [*verbs, *ALIASES], n=1, cutoff=0.7)
    return f" Is it {close[0]!r}?" if close else ""


def _overview(verbs: Mapping[str, type]) -> str:
    width, columns = max(map(len, verbs)), get_terminal_size().columns
    lines = (
        fill(f"  {verb:{width}}  {_summary(command)}", columns, subsequent_indent=" " * (width + 4))
        for verb, command in verbs.items()
    )
    return "\n".join((WAY, f"The {len(verbs)} verbs:\n", *lines, "", ENDING))


def _summary(command: type) -> str:
    """The first line of a command's docstring."""
    return (getdoc(command) or "").partition("\n")[0]


def _say_version() -> NoReturn:
    from importlib.metadata import version

    print(PROGRAM, version(PROGRAM))
    raise SystemExit


def _complete(verbs: Mapping[str, type], arguments: Sequence[str]) -> None:
    """Write what a shell needs to complete commands; tyro knows how, and exits."""
    import tyro

    options = {verb: understood(command, choices=True) for verb, command in verbs.items()}
    tyro.extras.subcommand_cli_from_dict(options, prog=PROGRAM, args=arguments)

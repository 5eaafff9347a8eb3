"""The command line: parse, call one verb, print."""

import sys
from collections.abc import Sequence
from contextlib import closing
from typing import Any

from stylesplat.cli.adjust import Adjust
from stylesplat.cli.bars import Bars
from stylesplat.cli.batch import Batch
from stylesplat.cli.check import Check
from stylesplat.cli.delete import Delete
from stylesplat.cli.demo import Demo
from stylesplat.cli.ending import status_after
from stylesplat.cli.evaluate import Evaluate
from stylesplat.cli.export import Export
from stylesplat.cli.import_ import Import
from stylesplat.cli.log_lines import LogLines
from stylesplat.cli.mask import Mask
from stylesplat.cli.objects import Objects
from stylesplat.cli.rename import Rename
from stylesplat.cli.render import Render
from stylesplat.cli.results import Answer
from stylesplat.cli.select import Select
from stylesplat.cli.sfm import Sfm
from stylesplat.cli.sheet import Sheet
from stylesplat.cli.studio import Studio
from stylesplat.cli.stylize import Stylize
from stylesplat.cli.telling import told
from stylesplat.cli.train import Train
from stylesplat.cli.usage import read
from stylesplat.cli.view import View
from stylesplat.progress import observed
from stylesplat.signals import WHOLE
from stylesplat.stderr import write_lines

VERBS = {
    "demo": Demo,
    "check": Check,
    "sfm": Sfm,
    "mask": Mask,
    "train": Train,
    "import": Import,
    "objects": Objects,
    "select": Select,
    "rename": Rename,
    "delete": Delete,
    "stylize": Stylize,
    "adjust": Adjust,
    "sheet": Sheet,
    "render": Render,
    "export": Export,
    "evaluate": Evaluate,
    "batch": Batch,
    "view": View,
    "studio": Studio,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Returns:
        0 if it is done, 1 if the user's input is at fault (one line on stderr says what), 130
        after Ctrl-C, 143 after SIGTERM. Wrong usage exits with 2.
    """
    command = read(VERBS, sys.argv[1:] if arguments is None else arguments)
    try:
        _run(command)
    except (Exception, KeyboardInterrupt) as error:
        status = status_after(error, lambda: getattr(command, "after_interruption", WHOLE))
        if status is None:
            raise
        return status
    return 0


def _run(command: Any) -> None:
    """Do it, and print what came of it."""
    from stylesplat.io.json_files import strict_json

    with closing(_observer()) as observer, observed(observer):
        result = command.run()
    if command.json:
        print(strict_json(result), flush=True)
    else:
        write_lines(*told(command, result))
    if isinstance(result, Answer):
        with closing(_observer()) as observer, observed(observer):
            result.rest()


def _observer() -> Bars | LogLines:
    return Bars() if sys.stderr.isatty() else LogLines()

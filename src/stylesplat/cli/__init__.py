"""The command line: read the arguments, call one verb, print its result."""

import sys
from collections.abc import Sequence
from contextlib import closing

from stylesplat.cli.arguments import read_arguments
from stylesplat.cli.batch import Batch
from stylesplat.cli.command import exit_status
from stylesplat.cli.demo import Demo, Doctor
from stylesplat.cli.evaluate import Evaluate
from stylesplat.cli.import_export import Export, Import
from stylesplat.cli.mask import LabelsCommand, MaskCommand
from stylesplat.cli.mcp import Mcp
from stylesplat.cli.objects import Delete, Objects, Rename, Select
from stylesplat.cli.render import Render, StudioCommand, ViewCommand
from stylesplat.cli.sfm import Check, Sfm
from stylesplat.cli.stylize import Adjust, Recolor, Sheet, Stylize
from stylesplat.cli.train import Train
from stylesplat.interrupts import raise_if_interrupted
from stylesplat.progress import observed, write_lines

COMMANDS = (
    *(Demo, Check, Sfm, MaskCommand, Train, Import, LabelsCommand, Objects, Select, Rename, Delete),
    *(Stylize, Recolor, Adjust, Sheet, Render, Export, Evaluate, Batch),
    *(ViewCommand, StudioCommand, Mcp, Doctor),
)
VERBS = {each.__name__.removesuffix("Command").lower(): each for each in COMMANDS}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Returns 0 if it is done, 1 if the user's input is at fault (one line on stderr says what), 130
    after Ctrl-C, 143 after SIGTERM. Wrong usage exits with 2, after a few lines on stderr.
    """
    command = None
    try:
        command = read_arguments(VERBS, sys.argv[1:] if arguments is None else arguments)
        raise_if_interrupted()
        from stylesplat.cli.bars import Bars
        from stylesplat.io.json_yaml import strict_json

        with closing(Bars()) as bars, observed(bars):
            if not command.serves:
                bars.fill_gaps()
            answer = command.run()
            bars.clear()
            if command.json:
                print(strict_json(answer.values), flush=True)
            else:
                write_lines(*answer.text())
            command.after_answer(answer.values)
    except (Exception, KeyboardInterrupt) as error:
        status = exit_status(error, command)
        if status is None:
            raise
        return status
    return 0

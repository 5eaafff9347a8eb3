"""The verbs that jobs of a batch can be, as the command line has them."""

import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import get_args

from tyro.conf import Positional, UseAppendAction

from stylesplat.batch_jobs.job_verbs import Content, JobOption, JobVerb
from stylesplat.cli.arguments import CALLED, known, read_command
from stylesplat.cli.export import Export
from stylesplat.cli.import_ import Import
from stylesplat.cli.mask import Mask
from stylesplat.cli.render import Render
from stylesplat.cli.select import Select
from stylesplat.cli.sheet import Sheet
from stylesplat.cli.stylize import Stylize
from stylesplat.cli.train import Train
from stylesplat.cli.wrong_usage import WrongUsage

# What a batch itself says
OURS = ("json", "verbose", "overwrite", "restart", "finish", "output", "file")
WITHIN = ("cells", "workers")  # what would make a batch of a job
PLACES = {  # what is made in the job's folder
    Export: ("output", "each"),
    Render: ("output",),
    Sheet: ("output",),
}
NAMED = (Export, Sheet)  # what makes a file there, whose name says of what kind
PATH, _ = CALLED[Path]
WORKS: dict[str, tuple[type, tuple[Content, ...], Content | None]] = {
    "train": (Train, ("capture",), "scene"),
    "import": (Import, ("splat",), "scene"),
    "mask": (Mask, ("capture", "scene"), None),
    "select": (Select, ("scene",), "scene"),
    "stylize": (Stylize, ("scene",), "scene"),
    "sheet": (Sheet, ("scene",), "files"),
    "render": (Render, ("scene",), "files"),
    "export": (Export, ("scene",), "files"),
}


def batch_verbs() -> dict[str, JobVerb]:
    """Those verbs, by name."""
    return {
        name: JobVerb(
            name=name,
            options=dict(_options(command)),
            takes=takes,
            makes=makes,
            needs_place=command in NAMED,
            check=partial(_fault, command, name),
        )
        for name, (command, takes, makes) in WORKS.items()
    }


def _options(command: type) -> Iterator[tuple[str, JobOption]]:
    """The options of a command but for what it works on, which comes first."""
    places = PLACES.get(command, ())
    _, *fields = zip(dataclasses.fields(command), known(command), strict=True)
    for field, option in fields:
        if field.name in (*OURS, *WITHIN) and field.name not in places:
            continue
        marks = get_args(field.type)
        found = JobOption(
            count=option.count,
            repeated=UseAppendAction in marks,
            is_path=option.placeholder == PATH and field.name not in places,
            is_place=field.name in places,
            is_word=Positional in marks,
        )
        for each in option.names:
            name = each.removeprefix("--").lower()
            if not name.startswith("-"):  # one letter, which nobody writes into a job file
                yield f"no-{name}" if field.default is True else name, found


def _fault(command: type, name: str, words: Sequence[str]) -> str | None:
    """What is wrong with words behind a verb."""
    try:
        read_command(command, words, f"stylesplat {name}")
    except WrongUsage as error:
        return str(error)
    return None

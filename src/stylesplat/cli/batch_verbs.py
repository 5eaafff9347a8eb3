"""The verbs that jobs of a batch can be, as the command line has them."""

import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints, is_typeddict

from tyro.conf import Positional, UseAppendAction

from stylesplat.batch_jobs.job_verbs import Content, JobOption, JobVerb
from stylesplat.cli.arguments import WrongUsage, read_command, without_none
from stylesplat.cli.export import Export
from stylesplat.cli.import_ import Import
from stylesplat.cli.mask import Mask
from stylesplat.cli.render import Render
from stylesplat.cli.select import Select
from stylesplat.cli.sheet import Sheet
from stylesplat.cli.stylize import Stylize
from stylesplat.cli.train import Train

# Options that a batch itself gives
OURS = ("json", "verbose", "overwrite", "restart", "finish", "output", "file")
WITHIN = ("cells", "workers")  # options that would make a batch of a job
PLACES = {  # options that say what is made in the job's folder
    Export: ("output", "each"),
    Render: ("output",),
    Sheet: ("output",),
}
NAMED = (Export, Sheet)  # verbs that make a file there, whose name says of what kind
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
POSITIONAL, REPEATED = (get_args(each)[1] for each in (Positional[int], UseAppendAction[int]))


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
    kinds = get_type_hints(command, include_extras=True)
    places = PLACES.get(command, ())
    _, *fields = (each for each in dataclasses.fields(command) if not each.kw_only)
    for field in fields:
        if field.name not in (*OURS, *WITHIN) or field.name in places:
            kind = kinds[field.name]
            yield from _option(field.name, kind, field.default, is_place=field.name in places)


def _option(
    field: str, kind: Any, default: object = None, *, is_place: bool = False
) -> Iterator[tuple[str, JobOption]]:
    """An option by each of its names; or those of settings, by theirs."""
    kind, *marks = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    for settings in filter(is_typeddict, marks):
        for name, each in get_type_hints(settings, include_extras=True).items():
            yield from _option(name, each)
        return
    configs = [mark for mark in marks if hasattr(mark, "aliases")]
    kind = without_none(kind)
    if REPEATED in marks:
        kind, *_ = get_args(kind)
    parts = get_args(kind) if get_origin(kind) is tuple else (kind,)
    found = JobOption(
        count=0 if kind is bool else "*" if Ellipsis in parts else len(parts),
        repeated=REPEATED in marks,
        is_path=parts[0] is Path and not is_place,
        is_place=is_place,
        is_word=POSITIONAL in marks,
    )
    names = [next((each.name for each in configs if each.name), field)]
    names += [alias[2:] for each in configs for alias in each.aliases or () if alias[1] == "-"]
    for name in names:
        spelled = name.replace("_", "-")
        yield f"no-{spelled}" if default is True else spelled, found


def _fault(command: type, name: str, words: Sequence[str]) -> str | None:
    """The error in the words after a verb, if there is one."""
    try:
        read_command(command, words, f"stylesplat {name}")
    except WrongUsage as error:
        return f"{error.fact}."
    return None

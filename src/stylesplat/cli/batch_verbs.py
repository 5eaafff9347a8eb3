"""The verbs that jobs of a batch can run, with the options that the command line has for them."""

import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints, is_typeddict

from tyro.conf import Positional, UseAppendAction

from stylesplat.batch_jobs.job import Content, JobOption, JobVerb
from stylesplat.cli.arguments import WrongUsage, read_command
from stylesplat.cli.export import Export
from stylesplat.cli.import_ import Import
from stylesplat.cli.mask import Mask
from stylesplat.cli.render import Render
from stylesplat.cli.select import Select
from stylesplat.cli.sheet import Sheet
from stylesplat.cli.stylize import Stylize
from stylesplat.cli.train import Train

HIDDEN = ("json", "verbose", "overwrite", "restart", "finish", "output", "file", "pick")
OUTPUTS = {Export: ("output", "each"), Render: ("output",), Sheet: ("output",)}
MAKES_FILE = (Export, Sheet)  # the suffix of the file that they make says of which kind it is
VERBS: dict[str, tuple[type, tuple[Content, ...], Content | None]] = {
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
            needs_output=command in MAKES_FILE,
            check=partial(_fault, command, name),
        )
        for name, (command, takes, makes) in VERBS.items()
    }


def _options(command: type) -> Iterator[tuple[str, JobOption]]:
    """The options of a command, except for what it works on, which is its first field."""
    kinds, outputs = get_type_hints(command, include_extras=True), OUTPUTS.get(command, ())
    _, *fields = (each for each in dataclasses.fields(command) if not each.kw_only)
    for field in fields:
        if field.name in outputs or field.name not in HIDDEN:
            kind = kinds[field.name]
            yield from _option(field.name, kind, field.default, is_output=field.name in outputs)


def _option(
    field: str, kind: Any, default: object = None, *, is_output: bool = False
) -> Iterator[tuple[str, JobOption]]:
    """An option by each of its names; or those of settings, by theirs."""
    kind, *marks = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    for settings in filter(is_typeddict, marks):
        for name, each in get_type_hints(settings, include_extras=True).items():
            yield from _option(name, each)
        return
    configs = [mark for mark in marks if hasattr(mark, "aliases")]
    if NoneType in get_args(kind):
        kind = next(each for each in get_args(kind) if each is not NoneType)
    if REPEATED in marks:
        (kind, *_) = get_args(kind)
    parts = get_args(kind) if get_origin(kind) is tuple else (kind,)
    found = JobOption(
        count=0 if kind is bool else "*" if Ellipsis in parts else len(parts),
        repeated=REPEATED in marks,
        is_path=parts[0] is Path and not is_output,
        is_output=is_output,
        is_positional=POSITIONAL in marks,
    )
    names = [next((each.name for each in configs if each.name), field)]
    names += [alias[2:] for each in configs for alias in each.aliases or () if alias[1] == "-"]
    for name in (each.replace("_", "-") for each in names):
        yield f"no-{name}" if default is True else name, found


def _fault(command: type, name: str, words: Sequence[str]) -> str | None:
    """What is wrong with the words after a verb."""
    try:
        read_command(command, words, f"stylesplat {name}")
    except WrongUsage as error:
        return f"{error.fact}."
    return None

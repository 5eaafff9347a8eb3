"""`stylesplat batch`, and the verbs that its jobs can run, with their options."""

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from tyro.conf import Positional, UseAppendAction

from stylesplat.argument_kinds import check_arguments
from stylesplat.batch_jobs.job import Content, JobOption, JobVerb
from stylesplat.cli.arguments import read_command, without_none
from stylesplat.cli.export import Export
from stylesplat.cli.import_ import Import
from stylesplat.cli.mask import Mask
from stylesplat.cli.options import CONTINUES, Json, Output, Verbose
from stylesplat.cli.render import Render
from stylesplat.cli.results import Answer
from stylesplat.cli.select import Select
from stylesplat.cli.sheet import Sheet
from stylesplat.cli.stylize import Stylize
from stylesplat.cli.train import Train
from stylesplat.errors import StyleSplatError, some

if TYPE_CHECKING:
    from stylesplat.batch_jobs.run_batch import BatchResult

NAMED = 5  # failed jobs in the last line; the table and the page have all
HIDDEN = ("json", "verbose", "overwrite", "restart", "finish", "output", "file", "pick")
OUTPUTS = {Export: ("output", "each"), Render: ("output",), Sheet: ("output",)}
MAKES_FILE = (Export, Sheet)  # the suffix of the file that they make says of which kind it is
JOB_VERBS: dict[str, tuple[type, tuple[Content, ...], Content | None]] = {
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


@dataclass(frozen=True)
class Batch:
    """Run many jobs: verbs over scenes, with lists of styles and settings, as a file says.

    Example: stylesplat batch jobs.yaml -o results --workers 2
    """

    jobs: Positional[Path]
    """YAML file with scenes and jobs; docs/batch.md describes it."""
    output: Output
    """Folder of the results, one for each job. What is done there already is not run again."""
    workers: int = 1
    """Processes at a time, each with its share of the cores."""
    ray: str | None = None
    """local, or the address of a Ray cluster (auto, HOST:6379, ray://HOST:10001) that runs the
    jobs instead; needs the extra stylesplat[ray]."""
    verbose: Verbose = False
    json: Json = False
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> dict[str, Any]:
        """Run the jobs."""
        done = batch(self.jobs, self.output, workers=self.workers, ray=self.ray)
        ends = {status: len(done.of(status)) for status in ("done", "failed", "skipped")}
        keys = ("job", "status", "seconds", "reason")
        jobs = [{key: getattr(record, key) for key in keys} for record in done.jobs]
        result = {"output": self.output, "page": done.page, "kept": done.kept, **ends}
        return Answer({**result, "jobs": jobs}, lambda: _refuse_failed(done))

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What to print after the jobs."""
        kept = f", {result['kept']} of them by an earlier run" if result["kept"] else ""
        yield f"{self.output}: {result['done']} of {len(result['jobs'])} jobs are done{kept}."
        yield f"Page: {result['page']}"


@check_arguments
def batch(
    jobs: Path | str, output: Path | str, *, workers: int = 1, ray: str | None = None
) -> "BatchResult":
    """Run many jobs, each as a process of the command line: verbs over scenes, as a file says.

    Jobs that an earlier run has done with the same inputs, settings and version are not run again.
    A job that fails raises nothing: see the `failed` ones of the result.

    Args:
        jobs: The job file, YAML; see docs/batch.md.
        output: Folder of the results, one for each job.
        workers: Processes at a time, each with its share of the cores.
        ray: `local`, or the address of a Ray cluster that runs the jobs instead.

    Returns:
        How each job ended, with what its verb measured.

    Raises:
        StyleSplatError: If the file is wrong, or names what does not exist; if the folder holds
            something else; or if the cluster cannot be reached or is too small.
    """
    from stylesplat.batch_jobs.job_file import plan_batch
    from stylesplat.batch_jobs.run_batch import run_batch

    planned = plan_batch(Path(jobs), batch_verbs())
    return run_batch(planned, Path(output), workers=workers, ray=ray)


def _refuse_failed(done: "BatchResult") -> None:
    failed, skipped = done.of("failed"), done.of("skipped")
    if failed:
        others = f" ({len(skipped)} behind them skipped)" if skipped else ""
        faults = [f"{record.job}: {record.reason.rstrip('.')}" for record in failed[:NAMED]]
        rest = some([record.job for record in failed[NAMED:]])
        raise StyleSplatError(
            f"{len(failed)} of {len(done.jobs)} jobs failed{others}: "
            f"{'; '.join([*faults, rest] if rest else faults)}. Mend that; the same command runs "
            "only these again."
        )


def batch_verbs() -> dict[str, JobVerb]:
    """The verbs that jobs can run, by name."""
    return {
        name: JobVerb(
            name=name,
            options=dict(_options(command)),
            takes=takes,
            makes=makes,
            needs_output=command in MAKES_FILE,
            check=partial(_fault, command, name),
        )
        for name, (command, takes, makes) in JOB_VERBS.items()
    }


def _options(command: type) -> Iterator[tuple[str, JobOption]]:
    """The options of a command by each of their names, except for what it works on: the first."""
    kinds, outputs = get_type_hints(command, include_extras=True), OUTPUTS.get(command, ())
    _, *fields = (each for each in dataclasses.fields(command) if not each.kw_only)
    for field in fields:
        kind, is_output = kinds[field.name], field.name in outputs
        if field.name in HIDDEN and not is_output:
            continue
        settings = next(filter(is_typeddict, get_args(kind)), None)
        shared = {} if settings is None else get_type_hints(settings, include_extras=True)
        for name, each in (shared or {field.name: kind}).items():
            names, option = _option(name, each, is_output)
            yield from ((f"no-{n}" if field.default is True else n, option) for n in names)


def _option(name: str, kind: Any, is_output: bool) -> tuple[list[str], JobOption]:
    kind, *marks = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    kind = without_none(kind)
    if REPEATED in marks:
        (kind, *_) = get_args(kind)
    parts = get_args(kind) if get_origin(kind) is tuple else (kind,)
    option = JobOption(
        count=0 if kind is bool else "*" if Ellipsis in parts else len(parts),
        repeated=REPEATED in marks,
        is_path=parts[0] is Path and not is_output,
        is_output=is_output,
        is_positional=POSITIONAL in marks,
    )
    named = [mark for mark in marks if hasattr(mark, "aliases")]  # by tyro.conf.arg
    names = [next((mark.name for mark in named if mark.name), name)]
    names += [alias[2:] for mark in named for alias in mark.aliases or () if alias[1] == "-"]
    return [each.replace("_", "-") for each in names], option


def _fault(command: type, name: str, words: Sequence[str]) -> str | None:
    """What is wrong with the words after a verb: the first lines in the box that tyro draws."""
    box = StringIO()
    try:
        with redirect_stderr(box):
            read_command(command, words, f"stylesplat {name}")
    except SystemExit:
        _title, _, text = box.getvalue().partition("\n")
        fact, *_advice = text.split("│ ──", 1)[0].split("╰")
        return f"{' '.join(fact.replace('│', ' ').split()).rstrip('.')}."
    return None

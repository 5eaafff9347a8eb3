"""`stylesplat batch`, and the verbs that its jobs can run."""

import re
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, fields
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, get_args, get_origin, get_type_hints

from tyro.conf import Positional

from stylesplat.batch_jobs.job import FolderContent, JobVerb
from stylesplat.cli.arguments import read_command, settings_of
from stylesplat.cli.command import COMMAND_NAMES, CONTINUES, Answer, Command, Output
from stylesplat.cli.import_export import Export, Import
from stylesplat.cli.mask import MaskCommand
from stylesplat.cli.objects import Select
from stylesplat.cli.render import Render
from stylesplat.cli.stylize import Recolor, Sheet, Stylize
from stylesplat.cli.train import Train
from stylesplat.errors import StyleSplatError, join_names
from stylesplat.io.kinds import Noun
from stylesplat.options import check_arguments

if TYPE_CHECKING:
    from stylesplat.batch_jobs.run_batch import BatchResult

FAULTS_LISTED = 5  # failed jobs in the last line; the table and the page have all
OUTPUTS = {"export": ("output", "each"), "render": ("output",), "sheet": ("output",)}
MAKES_FILE = ("export", "sheet")  # the suffix of the file that they make says of which kind it is
JOB_VERBS: dict[str, tuple[type, tuple[Noun, ...], FolderContent | None]] = {
    "train": (Train, ("capture",), "scene"),
    "import": (Import, ("splat",), "scene"),
    "mask": (MaskCommand, ("capture", "scene"), None),
    "select": (Select, ("scene",), "scene"),
    "recolor": (Recolor, ("scene",), "scene"),
    "stylize": (Stylize, ("scene",), "scene"),
    "sheet": (Sheet, ("scene",), "files"),
    "render": (Render, ("scene",), "files"),
    "export": (Export, ("scene",), "files"),
}


@dataclass(frozen=True)
class Batch(Command):
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
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> Answer:
        done = batch(self.jobs, self.output, workers=self.workers, ray=self.ray)
        ends = {status: len(done.of(status)) for status in ("done", "failed", "skipped")}
        keys = ("job", "status", "seconds", "reason")
        jobs = [{key: getattr(record, key) for key in keys} for record in done.jobs]
        values = {"output": self.output, "page": done.page, "kept": done.kept, **ends, "jobs": jobs}
        kept = f", {done.kept} of them by an earlier run" if done.kept else ""
        summary = f"{self.output}: {ends['done']} of {len(jobs)} jobs are done{kept}."
        return Answer(values, [summary, f"Page: {done.page}"])

    def after_answer(self, values: dict[str, Any]) -> None:
        failed = [job for job in values["jobs"] if job["status"] == "failed"]
        if failed:
            others = f" ({values['skipped']} behind them skipped)" if values["skipped"] else ""
            faults = [
                f"{job['job']}: {job['reason'].rstrip('.')}" for job in failed[:FAULTS_LISTED]
            ]
            rest = join_names([job["job"] for job in failed[FAULTS_LISTED:]])
            raise StyleSplatError(
                f"{len(failed)} of {len(values['jobs'])} jobs failed{others}: "
                f"{'; '.join([*faults, rest] if rest else faults)}. Mend that; the same command "
                "runs only these again."
            )


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


def batch_verbs() -> dict[str, JobVerb]:
    """The verbs that jobs can run, by name."""
    return {
        name: JobVerb(
            name=name,
            takes=takes,
            makes=makes,
            flags=_options_of(bool, command),
            paths=_options_of(Path, command).difference(OUTPUTS.get(name, ())),
            several=_options_of(tuple, command),
            outputs=OUTPUTS.get(name, ()),
            needs_output=name in MAKES_FILE,
            check=partial(_fault, command, name),
        )
        for name, (command, takes, makes) in JOB_VERBS.items()
    }


def _options_of(kind: type, command: type) -> frozenset[str]:
    """The names of the options of a command that take values of a kind."""
    hints = get_type_hints(command)
    found = [each for each in fields(command) if _holds(hints[each.name], kind)]
    names = [f"no-{each.name}" if each.default is True else each.name for each in found]
    for settings in settings_of(command).values():
        names += [name for name, hint in get_type_hints(settings).items() if _holds(hint, kind)]
    return frozenset(COMMAND_NAMES.get(name, name).replace("_", "-") for name in names)


def _holds(hint: Any, kind: type) -> bool:
    return kind in (hint, get_origin(hint)) or any(_holds(each, kind) for each in get_args(hint))


def _fault(command: type, name: str, words: Sequence[str]) -> str | None:
    """What is wrong with the words after a verb, as tyro says it."""
    box = StringIO()
    try:
        with redirect_stderr(box):
            read_command(command, words, f"stylesplat {name}")
    except StyleSplatError as error:
        return str(error)
    except SystemExit:
        _title, _, text = box.getvalue().partition("\n")
        fact, _, advice = text.partition("│ ──")
        fact = " ".join(fact.partition("╰")[0].replace("│", " ").split()).rstrip(".")
        near = re.search(r"meant.*?(--[\w-]+)", advice, re.DOTALL)
        return f"{fact}. Did you mean {near[1]}?" if near else f"{fact}."
    return None

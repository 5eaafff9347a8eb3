"""`stylesplat batch`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from tyro.conf import Positional

from stylesplat.argument_kinds import check_arguments
from stylesplat.cli.options import CONTINUES, Json, Output, Verbose
from stylesplat.cli.results import Answer
from stylesplat.errors import StyleSplatError, some

if TYPE_CHECKING:
    from stylesplat.batch_jobs.run_batch import BatchResult

NAMED = 5  # failed jobs in the last line; the table and the page have all


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
    from stylesplat.cli.batch_verbs import batch_verbs

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

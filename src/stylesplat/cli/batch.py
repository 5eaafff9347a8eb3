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
    from stylesplat.batch_jobs.run_batch import Batch as Done

NAMED = 5  # failed jobs that are told of at the end; the table and the page have all


@dataclass(frozen=True)
class Batch:
    """Run many jobs: verbs over scenes, with lists of styles and settings, as a file says.

    Example: stylesplat batch jobs.yaml -o results --workers 2
    """

    first: ClassVar = ("workers", "ray")
    jobs: Positional[Path]
    """YAML file with scenes and jobs; docs/batch.md says how it is written."""
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
        """Do it."""
        done = batch(self.jobs, self.output, workers=self.workers, ray=self.ray)
        jobs = [
            {"job": line.job, "status": line.status, "seconds": line.seconds, "reason": line.reason}
            for line in done.jobs
        ]
        ends = {status: len(done.of(status)) for status in ("done", "failed", "skipped")}
        result = {"output": self.output, "page": done.page, "kept": done.kept, **ends}
        return Answer({**result, "jobs": jobs}, lambda: refuse_failed(done))

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        kept = f", {result['kept']} of them by an earlier run" if result["kept"] else ""
        yield f"{self.output}: {result['done']} of {len(result['jobs'])} jobs are done{kept}."
        yield f"Page: {result['page']}"


@check_arguments
def batch(
    jobs: Path | str, output: Path | str, *, workers: int = 1, ray: str | None = None
) -> "Done":
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
        StyleSplatError: If the file is wrong, or names what is not there; if the folder holds
            something else; or if the cluster cannot be reached, or is unfit.
    """
    from stylesplat.batch_jobs.batch_plan import plan_batch
    from stylesplat.batch_jobs.run_batch import run_batch
    from stylesplat.cli.batch_verbs import batch_verbs

    planned = plan_batch(Path(jobs), batch_verbs())
    return run_batch(planned, Path(output), workers=workers, ray=ray)


def refuse_failed(done: "Done") -> None:
    """Raise a StyleSplatError if jobs are not done."""
    failed, skipped = done.of("failed"), done.of("skipped")
    if failed:
        others = f" ({len(skipped)} behind them skipped)" if skipped else ""
        said = "; ".join(f"{line.job}: {line.reason.rstrip('.')}" for line in failed[:NAMED])
        more = some([line.job for line in failed[NAMED:]])
        raise StyleSplatError(
            f"{len(failed)} of {len(done.jobs)} jobs failed{others}: {said}"
            f"{'; ' + more if more else ''}. Mend that; the same command runs only these again."
        )

"""A batch: what is done already is left, the rest is run, and all that ended is written down."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from msgspec.structs import replace

from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.batch_jobs.job_inputs import fingerprints
from stylesplat.batch_jobs.job_journal import (
    JOURNAL,
    JobJournal,
    JobLine,
    read_journal,
    still_valid,
)
from stylesplat.batch_jobs.job_page import PAGE, write_job_page
from stylesplat.batch_jobs.job_paths import refuse_address
from stylesplat.batch_jobs.local_crew import Crew, LocalCrew
from stylesplat.batch_jobs.orders import Outcome, order_of
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import changing, refuse_occupied
from stylesplat.progress import say, task

HEAD = f"{'':8}{'seconds':>9}{'GB':>7}  job"


@dataclass(frozen=True)
class Batch:
    """What came of a job file."""

    folder: Path
    """Where the results are, each in a folder of its job's name."""
    jobs: tuple[JobLine, ...]
    """How each ended, in the order of the file."""
    kept: int
    """How many of them were done by an earlier run."""
    page: Path
    """All pictures and numbers, for any browser."""

    def of(self, status: str) -> list[JobLine]:
        """The jobs that ended so: `done`, `failed` or `skipped`."""
        return [job for job in self.jobs if job.status == status]

    def __repr__(self) -> str:
        from stylesplat.scene.one_line import counted, one_line  # loads torch

        ends = (f"{len(self.of(s))} {s}" for s in ("done", "failed", "skipped") if self.of(s))
        return one_line(self, counted(len(self.jobs), "job"), *ends)


def run_batch(
    jobs: tuple[Job, ...],
    output: Path,
    *,
    workers: int = 1,
    ray: str | None = None,
) -> Batch:
    """Run jobs, but for those that an earlier run has done.

    Args:
        jobs: Each behind the one that it follows.
        output: The folder of all results; what an earlier run has done there is kept.
        workers: Processes at a time.
        ray: `local`, or the address of a Ray cluster that runs the jobs instead.

    Raises:
        StyleSplatError: If what they name cannot be read, the folder holds something else or is an
            address, or the cluster is unfit. Jobs that fail raise nothing.
    """
    refuse_address(output)
    output = output.resolve()
    _refuse_other(output)
    prints = fingerprints(jobs)
    with changing(output):
        output.mkdir(parents=True, exist_ok=True)
        earlier = read_journal(output)
        valid = still_valid(earlier, prints, output)
        others = [line for name, line in earlier.items() if name not in prints]
        journal = JobJournal(output, [*others, *valid.values()])
        todo = [job for job in jobs if job.name not in valid]
        lines = dict(valid)
        try:
            for line in _ended(todo, {*valid}, output, prints, (workers, ray)):
                journal.add(line)
                lines[line.job] = line
        finally:
            known = [(job, lines[job.name]) for job in jobs if job.name in lines]
            page = write_job_page(output / PAGE, known, of=len(jobs))
    return Batch(output, tuple(line for _, line in known), len(valid), page)


def _refuse_other(output: Path) -> None:
    """Raise a StyleSplatError for a folder that holds anything but an earlier run."""
    refuse_occupied(output, marker=JOURNAL, overwrite=True)
    if output.exists() and any(output.iterdir()) and not (output / JOURNAL).is_file():
        raise StyleSplatError(
            f"The folder {output} holds something that is no result of jobs. Choose another one."
        )


def _ended(
    todo: Sequence[Job],
    done: set[str],
    output: Path,
    prints: Mapping[str, str],
    where: tuple[int, str | None],
) -> Iterator[JobLine]:
    """Run jobs; how each ended, one by one, told in a table."""
    if not todo:
        return
    with task("batch", len(todo) + len(done), unit="job", done=len(done)) as bar:
        crew = _crew(todo, output, *where)
        say(HEAD)
        try:
            for job, outcome in scheduled(todo, done, crew, lambda: bar.note(_at_work(crew))):
                line = _line(job, outcome, output, prints[job.name], crew.threads_of(job))
                say(_row(line))
                bar.note(_at_work(crew))
                bar.advance()
                yield line
        finally:
            crew.close()


def _crew(todo: Sequence[Job], output: Path, workers: int, ray: str | None) -> Crew:
    if ray is None:
        return LocalCrew(output, workers)
    if workers != 1:
        raise StyleSplatError("Ray shares out its own cores. Leave --workers out with --ray.")
    from stylesplat.batch_jobs.ray_crew import RayCrew

    return RayCrew(todo, output, ray)


def scheduled(
    todo: Sequence[Job], done: set[str], crew: Crew, told: Callable[[], None]
) -> Iterator[tuple[Job, Outcome | str]]:
    """Have a crew run jobs, each after the one that it follows.

    Args:
        todo: The jobs, in order.
        done: The names of jobs that are done.
        crew: Who runs them.
        told: Called when others are at work.

    Yields:
        A job with how it ended; or with the name of the job for whose failure it is skipped.
    """
    waiting, done, failed = list(todo), set(done), set[str]()
    while waiting or crew.at_work:
        for job in [each for each in waiting if each.after in failed]:
            waiting.remove(job)
            failed.add(job.name)
            yield job, str(job.after)
        for job in [each for each in waiting if each.after is None or each.after in done]:
            if not crew.has_room:
                break
            waiting.remove(job)
            crew.begin(job)
            told()
        for job, outcome in crew.ended() if crew.at_work else ():
            (failed if outcome.status else done).add(job.name)
            yield job, outcome
            told()


def _line(
    job: Job, outcome: Outcome | str, output: Path, fingerprint: str, threads: int
) -> JobLine:
    line = JobLine(
        job=job.name,
        status="skipped",
        fingerprint=fingerprint,
        verb=job.verb.name,
        ended=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    if isinstance(outcome, str):
        return replace(line, reason=f"it follows {outcome}, which is not done.")
    return replace(
        line,
        status="failed" if outcome.status else "done",
        command=order_of(job, output, threads=threads).words,
        seconds=outcome.seconds,
        threads=threads,
        memory_gb=outcome.memory_gb,
        node=outcome.node,
        reason=outcome.reason,
        result=outcome.result,
    )


def _row(line: JobLine) -> str:
    """A row of the table."""
    memory = "" if line.memory_gb is None else f"{line.memory_gb:.2f}"
    seconds = f"{line.seconds:.1f}" if line.command else ""
    reason = f": {line.reason}" if line.reason else ""
    return f"{line.status:8}{seconds:>9}{memory:>7}  {line.job}{reason}"


def _at_work(crew: Crew) -> str:
    names = crew.at_work
    return ", ".join(names[:2]) + (f" and {len(names) - 2} more" if len(names) > 2 else "")

"""Job files, and an executor that only pretends to work."""

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from textwrap import dedent

from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_file import plan_batch
from stylesplat.batch_jobs.job_process import JobExecutor, JobRecord, ended_job
from stylesplat.cli.batch_verbs import batch_verbs

VERBS = batch_verbs()


def write_jobs(folder: Path, text: str) -> Path:
    """A job file beside two scenes and pictures that only have their names."""
    parts = [
        f"{name}/{part}" for name in ("garden", "desk") for part in ("scene.json", "splats.ply")
    ]
    for name in (*parts, "wave.jpg", "night.jpg", "other/wave.jpg", "wave.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        if not (folder / name).exists():
            (folder / name).write_text(name)
    path = folder / "jobs.yaml"
    path.write_text(dedent(text))
    return path


def planned(folder: Path, text: str) -> dict[str, Job]:
    """The jobs of a file, by name."""
    return {job.name: job for job in plan_batch(write_jobs(folder, text), VERBS)}


def pretend(slots: int, begun: list[str], fails: Callable[[str], bool]) -> JobExecutor:
    """An executor whose jobs end at once; `begun` gets their names."""

    def submit(job: Job) -> Future[JobRecord]:
        begun.append(job.name)
        future: Future[JobRecord] = Future()
        future.set_result(ended_job(job, "failed" if fails(job.name) else "done", ""))
        return future

    return JobExecutor(slots, submit)

"""Runs the jobs of a batch, except for those that are done, and writes a page of them."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b, file_digest
from html import escape
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

import msgspec
from msgspec.structs import replace

from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_file import refuse_address
from stylesplat.batch_jobs.job_process import JobRecord, RunJob, ended_job, local_processes
from stylesplat.errors import StyleSplatError, error_context, join_names
from stylesplat.evaluation.summary import flat
from stylesplat.figures.html_page import data_url
from stylesplat.interrupts import wait_until
from stylesplat.io.atomic import PARTIAL, locked_folder, refuse_occupied, write_file
from stylesplat.io.files import is_file
from stylesplat.io.images import jpeg_thumbnail
from stylesplat.io.kinds import PHOTOS, SOG_JSONS
from stylesplat.progress import say, task

BATCH_PAGE = "jobs.html"
BATCH_TEMPLATE = Path(__file__).with_name(BATCH_PAGE)
BATCH_PICTURES = ("before_after", "picture", "preview", "sheet")  # keys of results that name one
BATCH_SIDE = 420  # pixels of a picture at most: some 25 KB for each job
BATCH_MAX_NUMBERS = 14  # of a job: its record has all


def write_job_page(path: Path, jobs: Sequence[tuple[Job, JobRecord]], *, of: int) -> Path:
    """Write the page of the jobs that have ended, `of` so many in all; returns its path."""
    pictures = {job.name: job_picture(record, path.parent / job.name) for job, record in jobs}
    ends = (f"{n} {status}" for status, n in Counter(r.status for _, r in jobs).items())
    articles = [
        _article(record, pictures[job.name] or pictures.get(str(job.after))) for job, record in jobs
    ]
    page = Template(BATCH_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(path.parent.name),
        summary=f"Jobs: {of}. {', '.join(ends) or 'none has ended'}.",
        jobs="\n".join(articles),
    )
    write_file(path, page)
    return path


def job_picture(record: JobRecord, folder: Path) -> Path | None:
    """A picture of what a job has made, if there is one."""
    named = (record.result.get(key) for key in BATCH_PICTURES)
    found = [Path(each) for each in named if isinstance(each, str) and is_file(each)]
    if not found and record.verb == "render":
        found = [p for p in sorted(folder.rglob("*")) if p.suffix.lower() in PHOTOS]
    return found[0] if found else None


def _article(record: JobRecord, picture: Path | None) -> str:
    place, name = quote(f"{record.job}/"), escape(record.job)
    memory = record.memory and f", {record.memory} GB"
    took = f" {record.seconds:.1f} s{memory}" if record.command else ""
    reason = f": {record.reason}" if record.reason else ""
    rows = islice(flat(record.result), BATCH_MAX_NUMBERS)
    numbers = "".join(
        f"<dt>{escape(k)}</dt><dd>{format(v, ',' if isinstance(v, int) else '.4g')}</dd>"
        for k, v in rows
    )
    image = ""
    with suppress(StyleSplatError):  # a picture that cannot be read
        if picture:
            url = data_url(jpeg_thumbnail(picture, BATCH_SIDE), ".jpg")
            image = f'<img src="{url}" alt="{name}">'
    return (
        f'<article class="{record.status}"><a href="{place}">{image}</a>'
        f'<h2><a href="{place}">{name}</a></h2>'
        f"<p>{record.status}{took}{escape(reason)}</p><dl>{numbers}</dl></article>"
    )


RECORDS = "jobs.jsonl"  # in the batch's folder: a line of JSON for each job that has ended
SCENE_FILES = (".json", ".ply", ".safetensors")  # what makes a scene; pictures are drawn later
BATCH_HEAD = f"{'':8}{'seconds':>9}{'GB':>7}  job"


@dataclass(frozen=True)
class BatchResult:
    """How the jobs of a file ended."""

    folder: Path
    """Where the results are, each in a folder of its job's name."""
    jobs: tuple[JobRecord, ...]
    """In the order of the file."""
    kept: int
    """Number of jobs that an earlier run had done."""
    page: Path
    """All pictures and numbers, for any browser."""

    def of(self, status: str) -> list[JobRecord]:
        """The jobs that ended so: `done`, `failed` or `skipped`."""
        return [job for job in self.jobs if job.status == status]

    def __repr__(self) -> str:
        ends = (f"{len(self.of(s))} {s}" for s in ("done", "failed", "skipped") if self.of(s))
        return f"BatchResult({', '.join((f'{len(self.jobs)} jobs', *ends))})"


def run_batch(
    jobs: tuple[Job, ...], output: Path, *, workers: int = 1, ray: str | None = None
) -> BatchResult:
    """Run jobs, except for those that an earlier run has done in the same folder."""
    if workers < 1:
        raise StyleSplatError(f"Jobs need at least one worker, got {workers}. Use --workers 1.")
    if ray is not None and workers != 1:
        raise StyleSplatError("Ray distributes its cores itself. Leave out --workers with --ray.")
    refuse_address(output)
    output = output.resolve()
    refuse_occupied(output, marker=RECORDS, overwrite=True)
    path = output / RECORDS
    if output.exists() and any(output.iterdir()) and not path.is_file():
        raise StyleSplatError(
            f"The folder {output} holds something that is no result of jobs. Choose another one."
        )
    prints = fingerprints(jobs)
    with locked_folder(output):
        earlier = read_records(path)
        done = {
            name: record
            for name, record in earlier.items()
            if (record.status, record.fingerprint) == ("done", prints.get(name))
            and (output / name).exists()
        }
        kept = [r for n, r in earlier.items() if n in done or n not in prints]
        write_file(path, b"".join(map(_line, kept)))
        records, todo = dict(done), [job for job in jobs if job.name not in done]
        slots, runner = workers, local_processes(output, workers)
        if ray is not None:
            from stylesplat.batch_jobs.ray_tasks import MOST_TASKS, ray_tasks

            slots, runner = min(len(todo), MOST_TASKS), ray_tasks(todo, output, ray)
        try:
            with task("batch", len(jobs), unit="job", done=len(done)) as bar:
                for record in run_in_order(todo, {*done}, runner, slots, bar.note):
                    record = replace(record, fingerprint=prints[record.job])
                    if len(records) == len(done):
                        say(BATCH_HEAD)
                    say(_row(record))
                    with path.open("ab") as file:
                        file.write(_line(record))
                    records[record.job] = record
                    bar.advance()
        finally:
            known = [(job, records[job.name]) for job in jobs if job.name in records]
            page = write_job_page(output / BATCH_PAGE, known, of=len(jobs))
    return BatchResult(output, tuple(record for _, record in known), len(done), page)


def run_in_order(
    todo: Sequence[Job],
    done: set[str],
    runner: AbstractContextManager[RunJob],
    slots: int,
    note: Callable[[str], None] = lambda text: None,
) -> Iterator[JobRecord]:
    """Run up to `slots` jobs at a time, each after the one that it follows; yields the records."""
    if not todo:  # no cluster is needed
        return
    waiting, done, failed = {job.name: job for job in todo}, set(done), set[str]()
    running: dict[Future[JobRecord], str] = {}
    with ThreadPoolExecutor(slots) as pool, runner as run:
        while waiting or running:
            for job in [each for each in waiting.values() if each.after in failed]:
                failed.add(waiting.pop(job.name).name)
                yield ended_job(job, "skipped", f"it follows {job.after}, which is not done.")
            ready = [each for each in waiting.values() if each.after is None or each.after in done]
            for job in ready[: slots - len(running)]:
                running[pool.submit(run, waiting.pop(job.name))] = job.name
            note(join_names(running.values(), 2))
            if running:
                wait_until(lambda seconds: wait(running, seconds, FIRST_COMPLETED).done)
            for future in [each for each in running if each.done()]:
                record = future.result()
                del running[future]
                (done if record.status == "done" else failed).add(record.job)
                yield record


def fingerprints(jobs: Sequence[Job]) -> dict[str, str]:
    """A digest for each job of its inputs, its options and the package's version, by name."""
    digests: dict[str, str] = {}
    digest = cache(_digest_of)
    for job in jobs:
        with error_context(f"Cannot use the inputs of {job.name}"):
            source = digest(job.source) if job.source else digests[str(job.after)]
            options = {
                name: [
                    [subject, *(digest(v) if isinstance(v, Path) else v for v in texts)]
                    for subject, texts in value.parts
                ]
                for name, value in job.values.items()
            }
        digests[job.name] = _digest([version("stylesplat"), job.verb.name, source, options])
    return digests


def _digest_of(path: Path) -> str:
    """A digest of a file's content, or of the names, sizes and times of a folder's files."""
    if path.is_file() and path.name not in SOG_JSONS:
        with path.open("rb") as file:
            return file_digest(file, "blake2b").hexdigest()
    folder = path if path.is_dir() else path.parent
    suffixes = SCENE_FILES if (folder / "scene.json").is_file() else None
    found = []
    for file in sorted(each for each in folder.rglob("*") if each.is_file()):
        parts = file.relative_to(folder).parts
        is_hidden = any(part.startswith(".") or part.endswith(PARTIAL) for part in parts)
        if not is_hidden and (suffixes is None or file.suffix in suffixes):
            found.append([*parts, file.stat().st_size, file.stat().st_mtime_ns])
    return _digest(found)


def _digest(value: Any) -> str:
    return blake2b(json.dumps(value).encode(), digest_size=16).hexdigest()


def read_records(path: Path) -> dict[str, JobRecord]:
    """The last record of each job, by name; the torn line of a killed process is left out."""
    found: dict[str, JobRecord] = {}
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        with suppress(msgspec.DecodeError, UnicodeDecodeError):
            record = msgspec.json.decode(line, type=JobRecord)
            found[record.job] = record
    return found


def _line(record: JobRecord) -> bytes:
    return msgspec.json.encode(record) + b"\n"


def _row(record: JobRecord) -> str:
    seconds = f"{record.seconds:.1f}" if record.command else ""
    reason = f": {record.reason}" if record.reason else ""
    return f"{record.status:8}{seconds:>9}{record.memory:>7}  {record.job}{reason}"

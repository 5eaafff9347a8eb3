"""Writes a page with a picture and the numbers of every job: one HTML file, without network."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from html import escape
from itertools import islice
from pathlib import Path
from string import Template
from urllib.parse import quote

from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_process import JobRecord
from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.summary import flat
from stylesplat.figures.html_page import data_url
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import is_file
from stylesplat.io.images import jpeg_thumbnail
from stylesplat.io.kinds import PHOTOS

PAGE = "jobs.html"
TEMPLATE = Path(__file__).with_name(PAGE)
PICTURES = ("before_after", "picture", "preview", "sheet")  # keys of results that name a picture
SIDE = 420  # pixels of a picture at most: some 25 KB for each job
MAX_NUMBERS = 14  # of a job: its record has all


def write_job_page(path: Path, jobs: Sequence[tuple[Job, JobRecord]], *, of: int) -> Path:
    """Write the page of the jobs that have ended, `of` so many in all; returns its path."""
    pictures = {job.name: job_picture(record, path.parent / job.name) for job, record in jobs}
    ends = (f"{n} {status}" for status, n in Counter(r.status for _, r in jobs).items())
    articles = [
        _article(record, pictures[job.name] or pictures.get(str(job.after))) for job, record in jobs
    ]
    page = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(path.parent.name),
        summary=f"Jobs: {of}. {', '.join(ends) or 'none has ended'}.",
        jobs="\n".join(articles),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def job_picture(record: JobRecord, folder: Path) -> Path | None:
    """A picture of what a job has made, if there is one."""
    named = (record.result.get(key) for key in PICTURES)
    found = [Path(each) for each in named if isinstance(each, str) and is_file(each)]
    if not found and record.verb == "render":
        found = [p for p in sorted(folder.rglob("*")) if p.suffix.lower() in PHOTOS]
    return found[0] if found else None


def _article(record: JobRecord, picture: Path | None) -> str:
    place, name = quote(f"{record.job}/"), escape(record.job)
    memory = record.memory and f", {record.memory} GB"
    took = f" {record.seconds:.1f} s{memory}" if record.command else ""
    reason = f": {record.reason}" if record.reason else ""
    rows = islice(flat(record.result), MAX_NUMBERS)
    numbers = "".join(
        f"<dt>{escape(k)}</dt><dd>{format(v, ',' if isinstance(v, int) else '.4g')}</dd>"
        for k, v in rows
    )
    image = ""
    with suppress(StyleSplatError):  # a picture that cannot be read
        if picture:
            url = data_url(jpeg_thumbnail(picture, SIDE), ".jpg")
            image = f'<img src="{url}" alt="{name}">'
    return (
        f'<article class="{record.status}"><a href="{place}">{image}</a>'
        f'<h2><a href="{place}">{name}</a></h2>'
        f"<p>{record.status}{took}{escape(reason)}</p><dl>{numbers}</dl></article>"
    )

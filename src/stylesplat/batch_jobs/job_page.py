"""A page with a picture and the numbers of every job of a batch: one HTML file, without network."""

import io
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from itertools import islice
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

from PIL import Image

from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.batch_jobs.job_journal import JobLine
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import is_file

PAGE = "jobs.html"
TEMPLATE = Path(__file__).with_name(PAGE)
PICTURES = ("before_after", "picture", "preview", "sheet")  # what results call theirs
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".gif")
SIDE, QUALITY = 420, 80  # pixels at most, and JPEG's quality: some 20 KB a job
MAX_NUMBERS = 14  # of a job: the journal has all


def write_job_page(path: Path, jobs: Sequence[tuple[Job, JobLine]], *, of: int) -> Path:
    """Write the page of those jobs of a batch that have ended.

    Args:
        path: The HTML file to make, in the folder of the results.
        jobs: Which, with how each ended.
        of: How many there are in all.

    Returns:
        The file.

    Raises:
        StyleSplatError: If it cannot be written.
    """
    shown = {job.name: picture_of(line, path.parent / job.name) for job, line in jobs}
    states = [line.status for _, line in jobs]
    ends = (f"{states.count(each)} {each}" for each in dict.fromkeys(states))
    page = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(path.parent.name),
        summary=f"Jobs: {of}. {', '.join(ends) or 'none has ended'}.",
        jobs="\n".join(_article(job, line, _shown(job, shown)) for job, line in jobs),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def numbers_in(result: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, int | float]]:
    """The numbers of a result, with the names that lead to each.

    Example:
        >>> [*numbers_in({"psnr": 31.5, "nnfm_after": {"vase": 0.25}, "scene": "x"})]
        [('psnr', 31.5), ('nnfm_after vase', 0.25)]
    """
    for name, value in result.items():
        called = f"{before} {name}".strip()
        if isinstance(value, Mapping):
            yield from numbers_in(value, called)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield called, value


def picture_of(line: JobLine, folder: Path) -> Path | None:
    """A picture of what a job has made, if there is one."""
    named = (line.result.get(key) for key in PICTURES)
    found = [Path(each) for each in named if isinstance(each, str) and is_file(each)]
    if not found and line.verb == "render" and folder.is_dir():
        found = [p for p in sorted(folder.rglob("*")) if p.suffix.lower() in SUFFIXES]
    return found[0] if found else None


def _shown(job: Job, pictures: Mapping[str, Path | None]) -> Path | None:
    """A job's own picture, or that of what it follows."""
    return pictures[job.name] or pictures.get(str(job.after))


def _article(job: Job, line: JobLine, picture: Path | None) -> str:
    place = quote(f"{job.name}/")
    memory = "" if line.memory_gb is None else f", {line.memory_gb:.2f} GB"
    took = f" {line.seconds:.1f} s{memory}" if line.command else ""
    reason = f": {line.reason}" if line.reason else ""
    rows = islice(numbers_in(line.result), MAX_NUMBERS)
    numbers = "".join(f"<dt>{escape(k)}</dt><dd>{_number(v)}</dd>" for k, v in rows)
    small = _thumbnail(picture) if picture else ""
    shown = f'<img src="{small}" alt="{escape(job.name)}">' if small else ""
    return (
        f'<article class="{line.status}"><a href="{place}">{shown}</a>'
        f'<h2><a href="{place}">{escape(job.name)}</a></h2>'
        f"<p>{line.status}{took}{escape(reason)}</p><dl>{numbers}</dl></article>"
    )


def _number(value: int | float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def _thumbnail(path: Path) -> str:
    """A small JPEG as a URL that holds it; nothing of a picture that cannot be read."""
    small = io.BytesIO()
    try:
        with Image.open(path) as picture:
            flat = picture.convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError):
        return ""
    flat.thumbnail((SIDE, SIDE))
    flat.save(small, "JPEG", quality=QUALITY)
    return f"data:image/jpeg;base64,{b64encode(small.getvalue()).decode()}"

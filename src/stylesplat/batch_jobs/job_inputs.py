"""Fingerprints of jobs: equal as long as the same command over the same files would be run."""

import json
from collections.abc import Iterator, Mapping
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.errors import within
from stylesplat.io.atomic import PARTIAL
from stylesplat.io.files import is_folder
from stylesplat.io.kinds import SOG_META
from stylesplat.io.plain_yaml import MAX_YAML, parse_yaml

RECIPE = "recipe"  # the option whose file names further files
READ_BYTES = 2**26  # files up to this size are read; of larger ones, and in folders, time and size
SCENE_JSON = "scene.json"
SCENE_PARTS = (".json", ".ply", ".safetensors")  # of a scene; pictures are drawn into it later


def fingerprints(jobs: tuple[Job, ...]) -> dict[str, str]:
    """A digest for each job of its inputs, its settings and the package's version, by name.

    Raises:
        StyleSplatError: If something cannot be read.
    """
    digests: dict[str, str] = {}
    digest_of.cache_clear()
    for job in jobs:
        digests[job.name] = _fingerprint(job, digests)
    return digests


def _fingerprint(job: Job, earlier: Mapping[str, str]) -> str:
    source = earlier[job.after] if job.after else digest_of(_source(job))
    options = {
        name: [choice.given, *([] if choice.inputs else choice.words)]
        for name, choice in job.options
    }
    objects = [[word.partition("=")[0] for word in c.words] for n, c in job.options if n == "style"]
    inputs = [digest_of(path) for path in _files(job)]
    return _digest([version("stylesplat"), job.verb.name, source, options, objects, inputs])


def _source(job: Job) -> Path:
    """What to look at of what a job works on: of a splat in parts all of them."""
    assert job.source is not None
    return job.source.parent if job.source.name == SOG_META else job.source


def _files(job: Job) -> Iterator[Path]:
    """What the options name, and what recipes among that name."""
    yield from job.inputs
    for name, choice in job.options:
        for recipe in choice.inputs if name == RECIPE else ():
            with within(f"Cannot use the recipe {recipe}"):
                yield from _named_in(parse_yaml(recipe.read_bytes()[:MAX_YAML]), recipe.parent)


def _named_in(value: Any, folder: Path) -> Iterator[Path]:
    """Files that a recipe names, as far as there are such."""
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _named_in(each, folder)
    elif isinstance(value, str) and "\0" not in value and len(value) < 4096:
        path = folder / value
        if path.is_file():
            yield path


@cache
def digest_of(path: Path) -> str:
    """What a file holds; of a large one, and of a folder's files, size and time.

    Of a scene only the files that make it: pictures of it are drawn there at any time.
    """
    if is_folder(path):
        return _digest([[str(p.relative_to(path)), *_size_and_time(p)] for p in _parts(path)])
    if path.stat().st_size > READ_BYTES:
        return _digest(_size_and_time(path))
    return blake2b(path.read_bytes(), digest_size=16).hexdigest()


def _parts(folder: Path) -> list[Path]:
    if (folder / SCENE_JSON).is_file():
        return sorted(p for p in folder.iterdir() if p.suffix in SCENE_PARTS and p.name[0] != ".")
    files = (p for p in folder.rglob("*") if p.is_file())
    return sorted(p for p in files if not _is_aside(p.relative_to(folder)))


def _is_aside(path: Path) -> bool:
    """Whether a file is hidden, or lies in a folder that is, or that an unfinished run left."""
    return any(part.startswith(".") or part.endswith(PARTIAL) for part in path.parts)


def _size_and_time(path: Path) -> list[int]:
    found = path.stat()
    return [found.st_size, found.st_mtime_ns]


def _digest(value: Any) -> str:
    return blake2b(json.dumps(value).encode(), digest_size=16).hexdigest()

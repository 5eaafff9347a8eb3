"""Job files: which verbs, over which scenes, with which options; see docs/batch.md."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from stylesplat.batch_jobs.job_paths import path_in
from stylesplat.batch_jobs.job_verbs import JobVerb
from stylesplat.errors import StyleSplatError, within
from stylesplat.io.files import read_bytes
from stylesplat.io.kinds import SPLATS
from stylesplat.io.plain_yaml import MAX_YAML, Place, lines_of, parse_yaml

TOP = ("scenes", "jobs")  # the keys of a job file
BESIDE = ("name", "scenes", "needs", "then")  # those of a job, but for its verb
EXAMPLE = "Write `- stylize: {style: {vase: wave.jpg}}`."
MAX_DEEP = 8  # jobs that follow each other; their names grow with each


class Needs(msgspec.Struct, frozen=True):
    """What a job takes of a machine, where it is not what such jobs usually take."""

    cpus: Annotated[int, Meta(ge=1, le=4096)] | None = None
    """Cores, each with one thread."""
    gpus: Annotated[int, Meta(ge=0, le=64)] | None = None
    memory: Annotated[float, Meta(gt=0, le=65536)] | None = None
    """GB."""


@dataclass(frozen=True)
class Entry:
    """A verb with all the values that its options are to take, and what follows it."""

    verb: JobVerb
    options: Mapping[str, Any]
    """Plain values; lists multiply."""
    lines: Mapping[str, int]
    """Of the options, in the file."""
    line: int
    """Of the verb."""
    name: str | None
    """Takes the place of the verb in names of results."""
    scenes: tuple[tuple[str, Path], ...]
    """Names and places of what it works on; none if it follows another job."""
    needs: Needs
    then: tuple["Entry", ...]


def read_job_file(path: Path, verbs: Mapping[str, JobVerb]) -> tuple[Entry, ...]:
    """Read a job file.

    Args:
        path: The YAML file; paths in it are relative to its folder.
        verbs: What jobs can be.

    Raises:
        StyleSplatError: If it is no such file; the line in it is named.
    """
    with within(f"Cannot use the jobs in {path}"):
        text = read_bytes(path, most=MAX_YAML)
        content = parse_yaml(text)
        reader = _Reader(path.parent, verbs, lines_of(text))
        return reader.entries(content)


class _Reader:
    """Reads the values of one file, and knows their lines."""

    def __init__(self, folder: Path, verbs: Mapping[str, JobVerb], lines: dict[Place, int]) -> None:
        self._folder, self._verbs, self._lines = folder, verbs, lines

    def entries(self, content: Any) -> tuple[Entry, ...]:
        """The jobs of the whole file."""
        if not isinstance(content, dict):
            raise StyleSplatError("it must hold `scenes:` and `jobs:`.")
        self._check_keys(content, TOP, ())
        scenes = self._scenes(content.get("scenes"), ("scenes",))
        jobs = self._listed(content.get("jobs"), ("jobs",), EXAMPLE)
        return tuple(self._entry(job, ("jobs", n), scenes) for n, job in enumerate(jobs))

    def _entry(self, job: Any, place: Place, scenes: tuple[tuple[str, Path], ...]) -> Entry:
        if not isinstance(job, dict):
            raise self._wrong(place, f"a job is VERB: {{OPTION: VALUE}}. {EXAMPLE}")
        self._check_keys(job, (*self._verbs, *BESIDE), place)
        named = [key for key in job if key in self._verbs]
        if len(named) != 1:
            got = " and ".join(named) or "none"
            raise self._wrong(place, f"a job has one verb, got {got}. Begin each with a dash.")
        verb, options = self._verbs[named[0]], job[named[0]]
        follows = "then" in place
        if follows and "scenes" in job:
            raise self._wrong((*place, "scenes"), "what follows a job works on its result.")
        if "scenes" in job:
            scenes = self._scenes(job["scenes"], (*place, "scenes"))
        if not follows and not scenes:
            raise self._wrong(place, f"{verb.name} has nothing to work on. List `scenes:`.")
        at = (*place, verb.name)
        options = self._mapping(options, at)
        self._check_keys(options, verb.options, at)
        then = self._listed(job.get("then", []), (*place, "then"), EXAMPLE, empty=True)
        if place.count("then") >= MAX_DEEP:
            raise self._wrong(place, f"more than {MAX_DEEP} jobs follow each other.")
        return Entry(
            verb=verb,
            options={self._spelled(key): value for key, value in options.items()},
            lines={self._spelled(key): self._line((*at, key)) for key in options},
            line=self._line(at),
            name=self._name(job, place),
            scenes=() if follows else scenes,
            needs=self._needs(job.get("needs"), (*place, "needs")),
            then=tuple(self._entry(each, (*place, "then", n), ()) for n, each in enumerate(then)),
        )

    def _scenes(self, scenes: Any, place: Place) -> tuple[tuple[str, Path], ...]:
        """Names and places, from a list of places or a map of both."""
        if isinstance(scenes, dict):
            texts = scenes
        else:
            listed = self._listed(scenes, place, "Write `scenes: [garden]`.", empty=True)
            texts = {}
            for number, each in enumerate(listed):
                path = self._path(each, (*place, number)) if isinstance(each, str) else None
                name = _name_of(path) if path else str(each)
                if name in texts:
                    both = f"{texts[name]} and {each}"
                    remedy = "Name them: `scenes: {one: FOLDER, other: FOLDER}`."
                    raise self._wrong((*place, number), f"{both} have one name, {name}. {remedy}")
                texts[name] = each
        for name, text in texts.items():
            if not isinstance(text, str) or not text:
                raise self._wrong((*place, name), "a scene is the path of a folder or a file.")
        return tuple((name, self._path(text, (*place, name))) for name, text in texts.items())

    def _path(self, text: str, place: Place) -> Path:
        with within(f"line {self._line(place)}"):
            return path_in(self._folder, text)

    def _name(self, job: dict[str, Any], place: Place) -> str | None:
        name = job.get("name")
        if name is not None and (not isinstance(name, str | int) or not str(name).strip()):
            raise self._wrong((*place, "name"), "name must be a text.")
        return None if name is None else str(name)

    def _needs(self, needs: Any, place: Place) -> Needs:
        needs = self._mapping(needs, place)
        self._check_keys(needs, Needs.__struct_fields__, place)
        try:
            return msgspec.convert(needs, Needs)
        except msgspec.ValidationError as error:
            raise self._wrong(place, f"needs: {error}.") from error

    def _mapping(self, value: Any, place: Place) -> dict[str, Any]:
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise self._wrong(place, f"{place[-1]} must be KEY: VALUE, as in {{steps: 300}}.")
        return value

    def _listed(self, value: Any, place: Place, remedy: str, *, empty: bool = False) -> list[Any]:
        if value is None and empty:
            return []
        if not isinstance(value, list) or not (value or empty):
            raise self._wrong(place, f"{place[-1]} must be a list. {remedy}")
        return value

    def _check_keys(self, given: Mapping[str, Any], known: Iterable[str], place: Place) -> None:
        names, seen = list(known), set()
        for key in given:
            if self._spelled(key) in seen:
                raise self._wrong((*place, key), f"{key} is listed twice.")
            seen.add(self._spelled(key))
            if self._spelled(key) not in names:
                near = get_close_matches(self._spelled(key), names, n=1)
                meant = f"Did you mean {near[0]!r}?" if near else f"Use one of {', '.join(names)}."
                raise self._wrong((*place, key), f"there is no key {key!r}. {meant}")

    @staticmethod
    def _spelled(key: str) -> str:
        return key.replace("_", "-")

    def _line(self, place: Place) -> int:
        """Of a value, or of what holds it."""
        while place and place not in self._lines:
            place = place[:-1]
        return self._lines.get(place, 1)

    def _wrong(self, place: Place, fault: str) -> StyleSplatError:
        return StyleSplatError(f"line {self._line(place)}: {fault}")


def _name_of(place: Path) -> str:
    """What a scene is called of which only the place is known."""
    return place.stem if place.suffix.lower() in SPLATS else place.name

"""Reads a job file, and multiplies its lists to jobs; docs/batch.md describes the format."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import product, zip_longest
from math import prod
from pathlib import Path
from typing import Any

import msgspec

from stylesplat.batch_jobs.job import Content, Job, JobVerb, Needs, OptionValue
from stylesplat.batch_jobs.option_values import (
    absolute_path,
    name_parts,
    option_values,
    refuse_address,
    result_name,
)
from stylesplat.errors import StyleSplatError, some, within
from stylesplat.io.files import is_there, read_bytes
from stylesplat.io.kinds import SPLATS, Kind, kind_of, no_capture, no_scene, no_splat
from stylesplat.io.plain_yaml import MAX_YAML, Place, lines_of, parse_yaml

MAX_JOBS = 20_000  # of a file: lists multiply sooner than one thinks
CONTENTS: dict[Kind, Content] = {"scene": "scene", "capture": "capture", "splat": "splat"}
REFUSALS = {"scene": no_scene, "capture": no_capture, "splat": no_splat}
TOP_KEYS = ("scenes", "jobs")
JOB_KEYS = ("name", "scenes", "needs", "then")  # beside the verb
EXAMPLE = "Write `- stylize: {style: {vase: wave.jpg}}`."


@dataclass(frozen=True)
class _Entry:
    """A verb with all combinations of its options, and the entries that follow it."""

    verb: JobVerb
    line: int
    label: str
    """Stands for the verb in names of results."""
    combinations: Sequence[tuple[Sequence[str], Mapping[str, OptionValue]]]
    """Parts of names of results, and the options."""
    needs: Needs
    then: Sequence["_Entry"]


def plan_batch(path: Path, verbs: Mapping[str, JobVerb]) -> tuple[Job, ...]:
    """The jobs of a file, each behind the one that it follows.

    Args:
        path: The YAML file; paths in it are relative to its folder.
        verbs: The verbs that jobs can run, by name.

    Raises:
        StyleSplatError: If the file is wrong, something that it names is missing, or two jobs
            would have the same result. The message names the line.
    """
    with within(f"Cannot use the jobs in {path}"):
        refuse_address(path)
        text = read_bytes(path, most=MAX_YAML)
        content, jobs = parse_yaml(text), list[Job]()
        for job in _Planner(path.parent, verbs, lines_of(text)).jobs(content):
            jobs.append(job)
            _check_count(len(jobs))
        _check_names(jobs)
        return tuple(jobs)


class _Planner:
    """Reads one file, whose lines it knows."""

    def __init__(self, folder: Path, verbs: Mapping[str, JobVerb], lines: dict[Place, int]) -> None:
        self._folder, self._verbs, self._lines = folder, verbs, lines

    def jobs(self, content: Any) -> Iterator[Job]:
        if not isinstance(content, dict):
            raise StyleSplatError("it must hold `scenes:` and `jobs:`.")
        self._check_keys(content, TOP_KEYS, ())
        shared = self._scenes(content.get("scenes"), ("scenes",))
        entries = self._list(content.get("jobs"), ("jobs",), EXAMPLE)
        if not entries:
            raise self._error(("jobs",), f"there are no jobs. {EXAMPLE}")
        for number, value in enumerate(entries):
            place: Place = ("jobs", number)
            entry, scenes = self._entry(value, place), shared
            if "scenes" in value:
                scenes = self._scenes(value["scenes"], (*place, "scenes"))
            if not scenes:
                raise self._error(place, f"{entry.verb.name} has no scenes. List `scenes:`.")
            for name, path in scenes.items():
                with within(f"line {entry.line}"):
                    kind = CONTENTS.get(kind_of(path))
                    if kind is None:
                        raise REFUSALS[entry.verb.takes[0]](path)
                yield from _expand(entry, name, kind, source=path)

    def _entry(self, value: Any, place: Place) -> _Entry:
        if not isinstance(value, dict):
            raise self._error(place, f"a job is VERB: {{OPTION: VALUE}}. {EXAMPLE}")
        self._check_keys(value, (*self._verbs, *JOB_KEYS), place)
        found = [key for key in value if key in self._verbs]
        if len(found) != 1:
            got = " and ".join(found) or "none"
            raise self._error(place, f"a job has one verb, got {got}. Begin each with a dash.")
        if "then" in place and "scenes" in value:
            raise self._error((*place, "scenes"), "what follows a job works on its result.")
        verb, label = self._verbs[found[0]], value.get("name")
        label = found[0] if label is None else label
        if not isinstance(label, str | int) or not str(label).strip():
            raise self._error((*place, "name"), "name must be a text.")
        try:
            needs = msgspec.convert(value.get("needs") or {}, Needs)
        except msgspec.ValidationError as error:
            raise self._error((*place, "needs"), f"needs: {error}.") from error
        then = self._list(value.get("then"), (*place, "then"), EXAMPLE)
        if then and verb.makes == "files":
            line = self._line((*place, "then", 0))
            raise StyleSplatError(f"line {line}: nothing can follow {verb.name}: it makes files.")
        return _Entry(
            verb=verb,
            line=self._line((*place, verb.name)),
            label=str(label),
            combinations=self._combinations(verb, value[verb.name], (*place, verb.name)),
            needs=needs,
            then=[self._entry(each, (*place, "then", n)) for n, each in enumerate(then)],
        )

    def _combinations(
        self, verb: JobVerb, options: Any, place: Place
    ) -> list[tuple[Sequence[str], Mapping[str, OptionValue]]]:
        """All combinations of the values of the options of a verb."""
        options = options or {}
        if not isinstance(options, dict):
            raise self._error(place, f"{verb.name} takes KEY: VALUE, as in {{steps: 300}}.")
        self._check_keys(options, verb.options, place)
        names, axes = [_spelled(key) for key in options], []
        for key, name in zip(options, names, strict=True):
            with within(f"line {self._line((*place, key))}"):
                values = option_values(name, verb.options[name], options[key], self._folder)
                for path in (p for each in values for p in each.paths if not is_there(p)):
                    raise StyleSplatError(f"{name}: there is no {path}. Check the name.")
            axes.append([*zip(name_parts(values), values, strict=True)])
        _check_count(prod(map(len, axes)))
        # The parser of the command line sees every value of every option once
        for row in zip_longest(*axes) if axes else [()]:
            values = [(own or axis[0])[1] for own, axis in zip(row, axes, strict=True)]
            with within(f"line {self._line(place)}"):
                _check_arguments(verb, dict(zip(names, values, strict=True)))
        return [
            ([part for part, _ in chosen], dict(zip(names, (v for _, v in chosen), strict=True)))
            for chosen in product(*axes)
        ]

    def _scenes(self, scenes: Any, place: Place) -> dict[str, Path]:
        """Names and paths, from a list of paths or from a map."""
        pairs: list[tuple[Any, Any]] = (
            [*scenes.items()]
            if isinstance(scenes, dict)
            else [*enumerate(self._list(scenes, place, "Write `scenes: [garden]`."))]
        )
        found: dict[str, Path] = {}
        for key, text in pairs:
            if not isinstance(text, str) or not text:
                raise self._error((*place, key), "a scene is the path of a folder or a file.")
            with within(f"line {self._line((*place, key))}"):
                path = absolute_path(self._folder, text)
            own = path.stem if path.suffix.lower() in SPLATS else path.name
            name = own if isinstance(key, int) else key
            if name in found:
                remedy = "Name them: `scenes: {one: FOLDER, other: FOLDER}`."
                raise self._error((*place, key), f"two scenes have one name, {name}. {remedy}")
            found[name] = path
        return found

    def _list(self, value: Any, place: Place, remedy: str) -> list[Any]:
        if value is not None and not isinstance(value, list):
            raise self._error(place, f"{place[-1]} must be a list. {remedy}")
        return value or []

    def _check_keys(self, given: Iterable[str], known: Iterable[str], place: Place) -> None:
        names, seen = list(known), set()
        for key in given:
            name = _spelled(key)
            if name in seen:
                raise self._error((*place, key), f"{key} is listed twice.")
            seen.add(name)
            if name not in names:
                near = get_close_matches(name, names, n=1)
                remedy = f"Did you mean {near[0]!r}?" if near else f"Use one of {', '.join(names)}."
                raise self._error((*place, key), f"there is no key {key!r}. {remedy}")

    def _line(self, place: Place) -> int:
        """The line of a value, or of what holds it."""
        while place and place not in self._lines:
            place = place[:-1]
        return self._lines.get(place, 1)

    def _error(self, place: Place, fact: str) -> StyleSplatError:
        return StyleSplatError(f"line {self._line(place)}: {fact}")


def _expand(
    entry: _Entry,
    base: str,
    content: Content,
    *,
    source: Path | None = None,
    after: str | None = None,
) -> Iterator[Job]:
    """The jobs of an entry over one scene or result, each before those that follow it."""
    if content not in entry.verb.takes:
        takes = " and ".join(f"{each}s" for each in entry.verb.takes)
        raise StyleSplatError(
            f"line {entry.line}: {entry.verb.name} works on {takes}, not on {base}."
        )
    for parts, values in entry.combinations:
        name = result_name(base, entry.label, *parts)
        yield Job(name, entry.verb, entry.line, source, content, after, values, entry.needs)
        for each in entry.then:
            yield from _expand(each, name, entry.verb.makes or content, after=name)


def _spelled(key: str) -> str:
    return key.replace("_", "-")


def _check_arguments(verb: JobVerb, values: Mapping[str, OptionValue]) -> None:
    job = Job("", verb, 1, None, "scene", None, values, Needs())
    if verb.needs_output and not job.has_output_name:
        names = " or ".join(name for name, each in verb.options.items() if each.is_output)
        raise StyleSplatError(
            f"{verb.name} makes a file in the job's folder. Name it with {names}."
        )
    words = job.arguments(Path("SCENE"), Path("FOLDER"))[1:]
    fault = verb.check(words if job.has_output_name else [*words, "--output=RESULT"])
    if fault:
        raise StyleSplatError(fault)


def _check_count(count: int) -> None:
    if count > MAX_JOBS:
        raise StyleSplatError(
            f"its lists multiply to {count:,} jobs, {MAX_JOBS:,} are allowed. Use several files."
        )


def _check_names(jobs: Sequence[Job]) -> None:
    """Refuse two jobs with one result, also where file systems take A for a."""
    seen: dict[str, Job] = {}
    for job in jobs:
        other = seen.setdefault(job.name.casefold(), job)
        if other is not job:
            lines = some(dict.fromkeys((other.line, job.line)))
            raise StyleSplatError(
                f"two jobs have the same result, {job.name}: line {lines}. Give one another "
                "`name:`, or remove what is listed twice."
            )

"""Reads a job file, and multiplies its lists to jobs; docs/batch.md describes the format."""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from itertools import islice, product, zip_longest
from math import prod
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import msgspec
from msgspec import Meta

from stylesplat.batch_jobs.job import FolderContent, Job, JobVerb, Needs, OptionValue
from stylesplat.errors import StyleSplatError, error_context, join_names, shorten
from stylesplat.io.files import is_there, read_bytes
from stylesplat.io.json_yaml import MAX_YAML, KeyPath, lines_of, parse_yaml
from stylesplat.io.kinds import NOUNS, SPLATS, kind_of, wrong_kind_error
from stylesplat.io.style_pictures import is_material
from stylesplat.options import convert_settings

MAX_JOBS = 20_000  # of a file: lists multiply sooner than one thinks
JOB_ADDRESS = re.compile(r"[A-Za-z][\w+.-]+:/")  # a scheme is longer than the letter of a drive
JOB_LONGEST = 120  # characters of a name: file systems take 255 bytes, and suffixes are appended
JOB_UNFIT = re.compile(r"[^\w.+~]+")  # characters that names of results do not have
SET_BY_BATCH = ("json", "overwrite", "restart", "finish", "output", "file", "pick")
SPELLINGS = {"stylise": "stylize"}
Scenes = list[str] | dict[str, str]
# What a file and a job may hold, and of what types; a job has a verb as well
JOB_FILE = {"scenes": Scenes, "jobs": Annotated[list[Any], Meta(min_length=1)]}
NEEDS = get_type_hints(Needs, include_extras=True)
JOB_BESIDE = {"name": str | int | None, "needs": dict, "scenes": Scenes | None, "then": list}


def plan_batch(path: Path, verbs: Mapping[str, JobVerb]) -> tuple[Job, ...]:
    """The jobs of a YAML file, each behind the one that it follows; errors name the line."""
    with error_context(f"Cannot use the jobs in {path}"):
        refuse_address(path)
        text = read_bytes(path, most=MAX_YAML)
        planner = _Planner(path.parent, verbs, text)
        jobs = (*islice(planner.jobs(parse_yaml(text)), MAX_JOBS + 1),)
        _check_count(len(jobs))
        _check_names(jobs)
        return jobs


def refuse_address(path: str | Path) -> None:
    """Raise a StyleSplatError for an address such as `s3://bucket/scene`."""
    if JOB_ADDRESS.match(str(path)):
        raise StyleSplatError(
            f"{shorten(str(path))!r} is an address, and jobs read and write files. Mount it "
            "(docs/batch.md says how), or copy it to a disk."
        )


class _Planner:
    """Reads one file, whose lines it knows."""

    def __init__(self, folder: Path, verbs: Mapping[str, JobVerb], text: bytes) -> None:
        self._folder, self._verbs, self._lines = folder, verbs, lines_of(text)

    def jobs(self, content: Any) -> Iterator[Job]:
        file = self._checked(content, JOB_FILE, ())
        shared = self._scenes(file.get("scenes", []), ("scenes",))
        for number, each in enumerate(file.get("jobs", [])):
            place: KeyPath = ("jobs", number)
            verb, jobs_over = self._entry(each, place)
            own = each.get("scenes")
            scenes = shared if own is None else self._scenes(own, (*place, "scenes"))
            if not scenes:
                raise self._error(place, f"{verb.name} has no scenes. List `scenes:`.")
            for name, path in scenes.items():
                with error_context(f"line {self._line(place)}"):
                    if (kind := kind_of(path)) not in NOUNS:
                        raise wrong_kind_error(path, verb.takes[0])
                yield from jobs_over(name, kind, source=path)

    def _entry(self, content: Any, place: KeyPath) -> tuple[JobVerb, Callable[..., Iterator[Job]]]:
        """The verb of a job of the file, and what makes its jobs over one scene or result."""
        known = (*self._verbs, *SPELLINGS)
        entry = self._checked(content, JOB_BESIDE | dict.fromkeys(known, dict | None), place)
        found = [name for name in known if name in entry]
        if len(found) != 1:
            got = " and ".join(found) or "none"
            raise self._error(place, f"a job has one verb, got {got}. Begin each with a dash.")
        (name,) = found
        verb, label = self._verbs[SPELLINGS.get(name, name)], entry.get("name")
        if "then" in place and entry.get("scenes") is not None:
            raise self._error((*place, "scenes"), "what follows a job works on its result.")
        if entry.get("then") and verb.makes == "files":
            fact = f"nothing can follow {name}: it makes files."
            raise self._error((*place, "then", 0), fact)
        needs = Needs(**self._checked(entry.get("needs", {}), NEEDS, (*place, "needs")))
        combinations = self._combinations(verb, entry[name] or {}, (*place, name))
        listed, line = enumerate(entry.get("then", [])), self._line((*place, name))
        then = [self._entry(each, (*place, "then", number))[1] for number, each in listed]

        def jobs_over(
            base: str,
            content: FolderContent,
            *,
            source: Path | None = None,
            after: str | None = None,
        ) -> Iterator[Job]:
            if content not in verb.takes:
                takes = " and ".join(f"{each}s" for each in verb.takes)
                raise StyleSplatError(f"line {line}: {verb.name} works on {takes}, not on {base}.")
            for parts, values in combinations:
                result = _result_name(base, verb.name if label is None else str(label), *parts)
                yield Job(result, verb, line, source, content, after, values, needs)
                for following in then:
                    yield from following(result, verb.makes or content, after=result)

        return verb, jobs_over

    def _checked(self, content: Any, hints: Mapping[str, Any], place: KeyPath) -> dict[str, Any]:
        """The values of a map of the file, of the types that the hints give."""
        if not isinstance(content, dict):
            raise self._error(place, "expected KEY: VALUE. docs/batch.md has examples.")
        found = {}
        for key, value in content.items():
            with error_context(f"line {self._line((*place, key))}"):
                found |= convert_settings({key: value}, hints)
        return found

    def _combinations(
        self, verb: JobVerb, options: dict[str, Any], place: KeyPath
    ) -> list[tuple[list[str], dict[str, OptionValue]]]:
        """Parts of names of results, and the options."""
        axes: dict[str, list[tuple[str, OptionValue]]] = {}
        for key, listed in options.items():
            name = key.replace("_", "-")
            with error_context(f"line {self._line((*place, key))}"):
                if name in axes:
                    raise StyleSplatError(f"{key} is listed twice.")
                values = _option_values(name, verb, listed, self._folder)
                axes[name] = [*zip(_name_parts(values), values, strict=True)]
        _check_count(prod(map(len, axes.values())))
        # The parser of the command line sees every value of every option once
        for row in zip_longest(*axes.values()) if axes else [()]:
            pairs = zip(axes, row, strict=True)
            values = {name: (own or axes[name][0])[1] for name, own in pairs}
            fault = _fault(verb, values)
            if fault:
                named = [key for key in options if f"--{key.replace('_', '-')}" in fault]
                raise self._error((*place, *named[:1]), fault)
        rows = product(*axes.values())
        return [
            ([part for part, _ in r], dict(zip(axes, (v for _, v in r), strict=True))) for r in rows
        ]

    def _scenes(self, scenes: Scenes, place: KeyPath) -> dict[str, Path]:
        """Names and paths, from a list of paths or from a map."""
        found: dict[str, Path] = {}
        for key, text in scenes.items() if isinstance(scenes, dict) else enumerate(scenes):
            with error_context(f"line {self._line((*place, key))}"):
                path = _absolute(self._folder, text)
                own = path.stem if path.suffix.lower() in SPLATS else path.name
                name = own if isinstance(key, int) else key
                if name in found:
                    remedy = "Name them: `scenes: {one: FOLDER, other: FOLDER}`."
                    raise StyleSplatError(f"two scenes have one name, {name}. {remedy}")
            found[name] = path
        return found

    def _line(self, place: KeyPath) -> int:
        """The line of a value, or of what holds it."""
        while place and place not in self._lines:
            place = place[:-1]
        return self._lines.get(place, 1)

    def _error(self, place: KeyPath, fact: str) -> StyleSplatError:
        return StyleSplatError(f"line {self._line(place)}: {fact}")


def _fault(verb: JobVerb, values: Mapping[str, OptionValue]) -> str | None:
    """What is wrong with options: the command line says it, but for the name of the output."""
    job = Job("", verb, 1, None, "scene", None, values, Needs())
    if verb.needs_output and not job.names_output:
        names = " or ".join(verb.outputs)
        return f"{verb.name} makes a file in the job's folder. Name it with {names}."
    words = job.arguments(Path("SCENE"), Path("FOLDER"))
    return verb.check(words if job.names_output else [*words, "--output=RESULT"])


def _check_count(count: int) -> None:
    if count > MAX_JOBS:
        raise StyleSplatError(
            f"its lists multiply to {count:,} jobs, {MAX_JOBS:,} are allowed. Use several files."
        )


def _check_names(jobs: Iterable[Job]) -> None:
    """Refuse two jobs with one result, also where file systems take A for a."""
    seen: dict[str, Job] = {}
    for job in jobs:
        other = seen.setdefault(job.name.casefold(), job)
        if other is not job:
            lines = join_names(dict.fromkeys((other.line, job.line)))
            raise StyleSplatError(
                f"two jobs have the same result, {job.name}: line {lines}. Give one another "
                "`name:`, or remove what is listed twice."
            )


# The values of options, and the names of results that are made from them


def _absolute(folder: Path, text: str) -> Path:
    refuse_address(text)
    return Path(os.path.abspath(folder / text))  # noqa: PTH100 - resolve() would follow links


def _option_values(name: str, verb: JobVerb, listed: Any, folder: Path) -> list[OptionValue]:
    """The values that an option takes in turn: a list in the file stands for each of its items.

    Options that take several values have them in a list of their own, within that list.
    """
    if name in SET_BY_BATCH and name not in verb.outputs:
        raise StyleSplatError(f"{name} is set by the batch itself. Leave it out.")
    values = listed if isinstance(listed, list) else [listed]
    if not values:
        raise StyleSplatError(f"{name} lists nothing. Leave it out.")
    if name == "style":  # OBJECT=IMAGE on the command line, a map in a job file
        found = [each for styles in values for each in _styles(styles, folder)]
    else:
        found = [_option_value(name, verb, each, folder) for each in values]
    paths = [each for value in found for _, texts in value.parts for each in texts]
    for path in paths:
        if isinstance(path, Path) and not is_there(path):
            raise StyleSplatError(f"{name}: there is no {path}. Check the name.")
    return found


def _option_value(name: str, verb: JobVerb, value: Any, folder: Path) -> OptionValue:
    if value is None:
        return OptionValue(None, ((name, ("default",)),))
    if name in verb.flags:
        if not isinstance(value, bool):
            raise StyleSplatError(f"{name} is true or false, not {value!r}.")
        return OptionValue((), ((name, ()),)) if value else OptionValue(None, (("no", (name,)),))
    if isinstance(value, list) and name not in verb.several:
        raise StyleSplatError(f"{name} takes one value; a list within a list has no meaning.")
    words = tuple(_word(name, each) for each in (value if isinstance(value, list) else [value]))
    if name in verb.outputs:
        for word in words:
            if Path(word).name != word or word.startswith("."):
                raise StyleSplatError(
                    f"{name} is a name in the job's own folder, without folders, not {word!r}."
                )
        return OptionValue(words, (("", words),))
    if name not in verb.paths:
        return OptionValue(words, ((name, words),))
    paths = tuple(_absolute(folder, word) for word in words)
    return OptionValue(tuple(map(str, paths)), ((name, paths),))


def _word(name: str, value: Any) -> str:
    if isinstance(value, bool):  # YAML reads `on` and `off` as booleans
        return "on" if value else "off"
    if not isinstance(value, str | int | float):
        raise StyleSplatError(f"{name} takes no such value: {value!r}.")
    return str(value)


def _styles(value: Any, folder: Path) -> list[OptionValue]:
    """The values of a map of objects and pictures, whose lists multiply."""
    try:
        styles = msgspec.convert(value, dict[str, str | list[str | list[str]]])
    except msgspec.ValidationError as error:
        raise StyleSplatError("style is a map: write {vase: wave.jpg}.") from error
    axes = []
    for name, listed in styles.items():
        paths = [
            tuple(p if is_material(p) else _absolute(folder, p) for p in pictures)
            for each in (listed if isinstance(listed, list) else [listed])
            for pictures in [[each] if isinstance(each, str) else each]
        ]
        if not all(paths) or not paths:
            raise StyleSplatError(f"style lists no pictures for {name}.")
        if any("," in str(path) for pictures in paths for path in pictures if len(pictures) > 1):
            raise StyleSplatError(f"a picture of {name} has a comma in its path. Rename it.")
        axes.append([(name, pictures) for pictures in paths])
    return [
        OptionValue(
            tuple(f"{name}={','.join(map(str, pictures))}" for name, pictures in chosen), chosen
        )
        for chosen in product(*axes)
        if chosen
    ]


def _name_parts(values: Sequence[OptionValue]) -> list[str]:
    """The shortest texts that tell the values of an option apart; empty for a single value."""
    if len(values) == 1:
        return [""]
    common = set(values[0].parts).intersection(*(each.parts for each in values[1:]))
    found: list[str] = []
    for detail in range(3):
        found = [
            "-".join(
                "-".join(filter(None, [subject, *(_text(each, detail) for each in texts)]))
                for subject, texts in value.parts
                if (subject, texts) not in common
            )
            for value in values
        ]
        if len(set(found)) == len(found):
            break
    return found


def _text(value: str | Path, detail: int) -> str:
    if isinstance(value, str):
        return value
    return (value.stem, value.name, f"{value.parent.name}-{value.name}")[detail]


def _result_name(*parts: str) -> str:
    """A name of a folder that all file systems take."""
    whole = "-".join(part for part in parts if part)
    name = JOB_UNFIT.sub("-", whole).strip("-.") or "job"
    if len(name) <= JOB_LONGEST and len(name.encode()) <= 2 * JOB_LONGEST:
        return name
    return f"{name[: JOB_LONGEST // 2]}~{sha256(whole.encode()).hexdigest()[:12]}"

"""From a job file to jobs: each a command line, a place, and the job that it follows."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product, zip_longest
from math import prod
from pathlib import Path

from stylesplat.batch_jobs.job_file import Entry, Needs, read_job_file
from stylesplat.batch_jobs.job_names import parts_of, result_name
from stylesplat.batch_jobs.job_paths import refuse_address
from stylesplat.batch_jobs.job_verbs import Content, JobVerb
from stylesplat.batch_jobs.products import Choice, choices
from stylesplat.errors import StyleSplatError, some, within
from stylesplat.io.files import is_there
from stylesplat.io.kinds import Kind, kind_of, no_capture, no_scene, no_splat

MAX_JOBS = 20_000  # of a file: lists multiply sooner than one thinks
CONTENTS: dict[Kind, Content] = {"scene": "scene", "capture": "capture", "splat": "splat"}
REFUSALS = {"scene": no_scene, "capture": no_capture, "splat": no_splat}

Chosen = tuple[tuple[str, Choice, str], ...]  # options, their values, what names say of these


@dataclass(frozen=True)
class Job:
    """One command over one scene."""

    name: str
    """That of its folder."""
    verb: JobVerb
    line: int
    """Of the job file."""
    source: Path | None
    """What it works on; None if that is another job's result."""
    content: Content
    """What that is."""
    after: str | None
    """The name of the job that it follows."""
    options: tuple[tuple[str, Choice], ...]
    needs: Needs

    def words(self, source: Path, folder: Path) -> list[str]:
        """The command line behind `stylesplat`, but for what is said of its output.

        Args:
            source: What it works on.
            folder: Its own.
        """
        words, options = [str(source)], []
        for name, choice in self.options:
            option = self.verb.options[name]
            if not choice.given:
                continue
            if option.is_word:
                words += choice.words
            elif option.count == 0:
                options.append(f"--{name}")
            elif option.repeated or option.count == 1:
                texts = [str(folder / w) for w in choice.words] if option.is_place else choice.words
                options += [f"--{name}={text}" for text in texts]
            else:
                options += [f"--{name}", *choice.words]
        return [self.verb.name, *words, *options]

    @property
    def is_in_folder(self) -> bool:
        """Whether the options name what it makes, in its folder; else it is the folder."""
        return any(self.verb.options[name].is_place for name, each in self.options if each.given)

    @property
    def processes(self) -> int:
        """How many train together: as many as there are GPUs for it."""
        return max(1, self.needs.gpus or 1) if self.verb.name == "train" else 1

    @property
    def inputs(self) -> Iterator[Path]:
        """Files and folders that its options name."""
        return (path for _, choice in self.options for path in choice.inputs)


def plan_batch(path: Path, verbs: Mapping[str, JobVerb]) -> tuple[Job, ...]:
    """The jobs of a file, each behind the one that it follows.

    Args:
        path: The job file.
        verbs: What jobs can be.

    Raises:
        StyleSplatError: If the file is wrong, something that it names is missing, or two jobs
            would have one result.
    """
    refuse_address(path)
    entries = read_job_file(path, verbs)
    with within(f"Cannot use the jobs in {path}"):
        return jobs_of(entries, path.parent)


def jobs_of(entries: Sequence[Entry], folder: Path) -> tuple[Job, ...]:
    """The jobs that entries multiply to, each behind the one that it follows.

    Args:
        entries: Verbs with all the values of their options.
        folder: What their paths are relative to.

    Raises:
        StyleSplatError: As `plan_batch` does.
    """
    jobs: list[Job] = []
    for entry in entries:
        for name, place in entry.scenes:
            jobs += _expanded(entry, folder, name, place=place)
            _check_count(len(jobs))
    _check_names(jobs)
    return tuple(jobs)


def _expanded(
    entry: Entry,
    folder: Path,
    base: str,
    *,
    place: Path | None = None,
    content: Content | None = None,
    after: str | None = None,
) -> Iterator[Job]:
    """The jobs of an entry over one scene or result, each with those that follow it."""
    with within(f"line {entry.line}"):
        content = content or _content_at(place, entry)
        if content not in entry.verb.takes:
            takes = " and ".join(f"{each}s" for each in entry.verb.takes)
            raise StyleSplatError(f"{entry.verb.name} works on {takes}, not on {base}.")
    for chosen in _products(entry, folder):
        name = result_name(base, entry.name or entry.verb.name, *(part for *_, part in chosen))
        options = tuple((option, choice) for option, choice, _ in chosen)
        job = Job(name, entry.verb, entry.line, place, content, after, options, entry.needs)
        yield job
        made = entry.verb.made_of(content)
        for each in entry.then:
            if made == "files":
                raise StyleSplatError(
                    f"line {each.line}: nothing can follow {entry.verb.name}, which makes files."
                )
            yield from _expanded(each, folder, name, content=made, after=name)


def _content_at(place: Path | None, entry: Entry) -> Content:
    """What lies at a place, as far as jobs can work on it."""
    assert place is not None  # what follows a job knows what that makes
    content = CONTENTS.get(kind_of(place))
    if content is None:
        raise REFUSALS[entry.verb.takes[0]](place)
    return content


def _products(entry: Entry, folder: Path) -> Iterator[Chosen]:
    """All combinations of the values of an entry's options."""
    axes: list[list[tuple[str, Choice, str]]] = []
    for name, value in entry.options.items():
        with within(f"line {entry.lines[name]}"):
            found = choices(name, entry.verb.options[name], value, folder)
            for missing in (p for each in found for p in each.inputs if not is_there(p)):
                raise StyleSplatError(f"{name}: there is no {missing}. Check the name.")
        parts = parts_of([each.shown for each in found])
        axes.append([(name, c, part) for c, part in zip(found, parts, strict=True)])
    _check_count(prod(map(len, axes)))
    _check_words(entry, axes)
    return product(*axes)


def _check_words(entry: Entry, axes: Sequence[Sequence[tuple[str, Choice, str]]]) -> None:
    """Have the command line check every value of every option once."""
    for row in zip_longest(*axes) if axes else [()]:
        chosen = [own or axis[0] for own, axis in zip(row, axes, strict=True)]
        options = tuple((name, choice) for name, choice, _ in chosen)
        job = Job("", entry.verb, entry.line, None, "scene", None, options, entry.needs)
        if entry.verb.needs_place and not job.is_in_folder:
            places = [name for name, each in entry.verb.options.items() if each.is_place]
            raise StyleSplatError(
                f"line {entry.line}: {entry.verb.name} makes a file in the job's folder. "
                f"Name it with {' or '.join(places)}."
            )
        words = job.words(Path("SCENE"), Path("FOLDER"))[1:]
        wrong = entry.verb.check(words if job.is_in_folder else [*words, "--output=RESULT"])
        if wrong:
            raise StyleSplatError(f"line {entry.line}: {wrong}")


def _check_count(count: int) -> None:
    if count > MAX_JOBS:
        raise StyleSplatError(
            f"its lists multiply to {count:,} jobs, {MAX_JOBS:,} are allowed. Use several files."
        )


def _check_names(jobs: Sequence[Job]) -> None:
    """Refuse two jobs with one result, also where systems take A for a."""
    seen: dict[str, Job] = {}
    for job in jobs:
        other = seen.setdefault(job.name.casefold(), job)
        if other is not job:
            lines = some(dict.fromkeys((other.line, job.line)))
            raise StyleSplatError(
                f"two jobs have one result, {job.name}: line {lines}. Give one another `name:`, or "
                "take out what is listed twice."
            )

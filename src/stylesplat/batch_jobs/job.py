"""A job: one command of the command line over one scene, and the options that verbs have."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Content = Literal["capture", "splat", "scene", "files"]


@dataclass(frozen=True)
class JobOption:
    """An option of a verb, which takes `count` values at a time; a flag takes 0."""

    count: int | Literal["*"]
    repeated: bool = False
    """It may be given several times, and appends."""
    is_path: bool = False
    """Its values are files or folders that must exist."""
    is_output: bool = False
    """It names what the job makes, within the job's folder."""
    is_positional: bool = False


@dataclass(frozen=True)
class JobVerb:
    """A verb of the command line that a job can run."""

    name: str
    options: Mapping[str, JobOption]
    """By name, without dashes in front."""
    takes: tuple[Content, ...]
    makes: Content | None
    """What its result is; None if that is what it works on."""
    needs_output: bool
    """An option must name the file that it makes."""
    check: Callable[[Sequence[str]], str | None]
    """Parses arguments, and returns what is wrong with them."""


class Needs(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Resources of a job, as the job file names them."""

    cpus: Annotated[int, Meta(ge=1, le=4096)] | None = None
    gpus: Annotated[int, Meta(ge=0, le=64)] | None = None
    memory: Annotated[float, Meta(gt=0, le=65536)] | None = None
    """GB."""


@dataclass(frozen=True)
class OptionValue:
    """One value of an option."""

    words: tuple[str, ...] | None
    """Its words on the command line, without the option's name; None leaves the option out."""
    parts: tuple[tuple[str, tuple[str | Path, ...]], ...]
    """What names of results and fingerprints are made from: subjects, each with texts or paths."""

    @property
    def paths(self) -> list[Path]:
        return [each for _, texts in self.parts for each in texts if isinstance(each, Path)]


@dataclass(frozen=True)
class Job:
    """One command over one scene."""

    name: str
    """Also the name of its folder."""
    verb: JobVerb
    line: int
    """In the job file."""
    source: Path | None
    """What it works on; None if that is the result of the job `after`."""
    content: Content
    after: str | None
    values: Mapping[str, OptionValue]
    needs: Needs

    @property
    def has_output_name(self) -> bool:
        """Whether options name what it makes in its folder; if not, its folder is the result."""
        return any(self.verb.options[n].is_output and v.words for n, v in self.values.items())

    @property
    def edits_copy(self) -> bool:
        """Whether it works on a copy of its capture, because its verb writes into captures."""
        return self.content == "capture" and self.verb.makes is None

    @property
    def processes(self) -> int:
        """Processes that train together, one for each GPU."""
        return max(1, self.needs.gpus or 1) if self.verb.name == "train" else 1

    def source_in(self, output: Path) -> Path:
        """What it works on, where all results lie in the folder `output`."""
        return self.source or output / str(self.after)

    def command(self, output: Path) -> tuple[str, ...]:
        """The command line after `stylesplat`."""
        folder = output / self.name
        source = folder if self.edits_copy else self.source_in(output)
        place = () if self.edits_copy or self.has_output_name else ("-o", str(folder))
        return (*self.arguments(source, folder), *place, "--overwrite", "--json")

    def arguments(self, source: Path, folder: Path) -> list[str]:
        positional, options = [str(source)], []
        for name, value in self.values.items():
            option = self.verb.options[name]
            if value.words is None:
                continue
            if option.is_positional:
                positional += value.words
            elif option.count == 0:
                options.append(f"--{name}")
            elif option.repeated or option.count == 1:
                words = [str(folder / w) for w in value.words] if option.is_output else value.words
                options += [f"--{name}={word}" for word in words]
            else:
                options += [f"--{name}", *value.words]
        return [self.verb.name, *positional, *options]

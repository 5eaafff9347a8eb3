"""A job: one command of the command line over one scene."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from stylesplat.io.kinds import FileKind, Noun

FolderContent = FileKind | Literal["files"]
POSITIONAL = ("capture",)  # options that have no name on the command line
TUPLES = ("region",)  # options that take several values at once; others are repeated


@dataclass(frozen=True)
class JobVerb:
    """A verb of the command line that a job can run, and what a job file has to know of it."""

    name: str
    takes: tuple[Noun, ...]
    makes: FolderContent | None
    """What its result is; None if that is what it works on."""
    flags: frozenset[str]
    """Options that are true or false."""
    paths: frozenset[str]
    """Options that name files or folders, which must exist."""
    several: frozenset[str]
    """Options that take several values; others take one."""
    outputs: tuple[str, ...]
    """Options that name what it makes, within the job's folder."""
    needs_output: bool
    check: Callable[[Sequence[str]], str | None]
    """Parses arguments, and returns what is wrong with them."""


@dataclass(frozen=True)
class Needs:
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
    content: FolderContent
    after: str | None
    values: Mapping[str, OptionValue]
    needs: Needs

    @property
    def edits_copy(self) -> bool:
        """Whether it works on a copy of its capture, because its verb writes into captures."""
        return self.content == "capture" and self.verb.makes is None

    @property
    def names_output(self) -> bool:
        """Whether an option names a file in its folder; if not, its folder is the result."""
        return any(self.values[name].words for name in self.verb.outputs if name in self.values)

    def source_in(self, output: Path) -> Path:
        """What it works on, where all results lie in the folder `output`."""
        return self.source or output / str(self.after)

    def command(self, output: Path) -> tuple[str, ...]:
        """The command line after `stylesplat`."""
        folder = output / self.name
        source = folder if self.edits_copy else self.source_in(output)
        place = () if self.edits_copy or self.names_output else ("-o", str(folder))
        return (self.verb.name, *self.arguments(source, folder), *place, "--overwrite", "--json")

    def arguments(self, source: Path, folder: Path) -> list[str]:
        """The words after the verb that the job file asks for."""
        positional, options = [str(source)], []
        for name, value in self.values.items():
            if (words := value.words) is None:
                continue
            if name in self.verb.outputs:
                words = [str(folder / word) for word in words]
            if name in POSITIONAL:
                positional += words
            elif name in self.verb.flags or name in TUPLES:
                options += [f"--{name}", *words]
            else:
                options += [f"--{name}={word}" for word in words]
        return [*positional, *options]

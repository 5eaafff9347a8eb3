"""What a job file may ask of a verb: its options, what it works on and what it makes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Content = Literal["capture", "splat", "scene", "files"]


@dataclass(frozen=True)
class JobOption:
    """An option of a verb."""

    count: int | Literal["*"]
    """How many values it takes at a time; 0 of a flag."""
    repeated: bool = False
    """Whether it may be given several times, and appends."""
    is_path: bool = False
    """Whether its values are files or folders that must be there."""
    is_place: bool = False
    """Whether it names what the job makes, within the job's folder."""
    is_word: bool = False
    """Whether it stands without its name, behind what the verb works on."""

    @property
    def takes_several(self) -> bool:
        """Whether it can have more than one value."""
        return self.repeated or self.count not in (0, 1)


@dataclass(frozen=True)
class JobVerb:
    """A verb of the command line that jobs can be."""

    name: str
    options: Mapping[str, JobOption]
    """By the names of the command line, without dashes in front."""
    takes: tuple[Content, ...]
    """What it works on."""
    makes: Content | None
    """What its result is; None if that is what it works on."""
    needs_place: bool
    """Whether an option must say what is made in the job's folder."""
    check: Callable[[Sequence[str]], str | None]
    """Says what is wrong with words behind the verb, without doing anything."""

    def made_of(self, content: Content | None) -> Content | None:
        """What its result is, of something; None if nobody knows what it is made of."""
        return self.makes or content

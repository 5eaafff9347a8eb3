"""From the values of an option in a job file to those that it takes in turn."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stylesplat.batch_jobs.job_paths import path_in
from stylesplat.batch_jobs.job_verbs import JobOption
from stylesplat.errors import StyleSplatError

Shown = tuple[str, tuple[str | Path, ...]]
"""What is said of a value: what it is of, and the value or its paths."""
STYLE = "style"  # the option that is OBJECT=IMAGE on the command line, and a map in a job file


@dataclass(frozen=True)
class Choice:
    """One of the values that an option takes in turn."""

    words: tuple[str, ...] = ()
    """As the command line has them, without the option's name; of a repeated option one a time."""
    shown: tuple[Shown, ...] = ()
    """What names of results say of it."""
    inputs: tuple[Path, ...] = ()
    """Files and folders that it names."""
    given: bool = True
    """Whether the option is given at all."""


def choices(name: str, option: JobOption, value: Any, folder: Path) -> list[Choice]:
    """What an option is to be: a list stands for each of its items in turn.

    Options that take several values have them in a list of their own, within that list.

    Args:
        name: The option.
        option: What it takes.
        value: What the file says.
        folder: That of the file, which paths are relative to.

    Raises:
        StyleSplatError: If it is nothing that such an option takes.
    """
    values = value if isinstance(value, list) else [value]
    if not values:
        raise StyleSplatError(f"{name} lists nothing. Leave it out.")
    if name == STYLE:
        return [choice for each in values for choice in _styles(each, folder)]
    return [_choice(name, option, each, folder) for each in values]


def _choice(name: str, option: JobOption, value: Any, folder: Path) -> Choice:
    if value is None:
        return Choice(shown=((name, ("default",)),), given=False)
    if option.count == 0:
        if not isinstance(value, bool):
            raise StyleSplatError(f"{name} is true or false, not {value!r}.")
        return Choice(shown=((name, ()) if value else ("no", (name,)),), given=value)
    if isinstance(value, list) and not option.takes_several:
        raise StyleSplatError(f"{name} takes one value; a list within a list has no meaning.")
    values = value if isinstance(value, list) else [value]
    if isinstance(option.count, int) and not option.repeated and len(values) != option.count:
        raise StyleSplatError(
            f"{name} takes {option.count} values: write [[{', '.join('x' * option.count)}]], for "
            "a list alone stands for each of its items in turn."
        )
    words = tuple(_word(name, each) for each in values)
    if option.is_place:
        for word in words:
            _check_place(name, word)
        return Choice(words, shown=(("", words),))
    if not option.is_path:
        return Choice(words, shown=((name, words),))
    paths = tuple(path_in(folder, word) for word in words)
    return Choice(tuple(map(str, paths)), ((name, paths),), paths)


def _styles(value: Any, folder: Path) -> list[Choice]:
    """What a map of objects and pictures stands for, whose lists multiply."""
    if not isinstance(value, dict) or not value:
        raise StyleSplatError("style is a map: write {vase: wave.jpg}.")
    found = [Choice()]
    for name, pictures in value.items():
        several = pictures if isinstance(pictures, list) else [pictures]
        if not several:
            raise StyleSplatError(f"style lists no pictures for {name}.")
        each = [_painting(name, picture, folder) for picture in several]
        found = [_both(before, after) for before in found for after in each]
    return found


def _painting(name: str, picture: Any, folder: Path) -> Choice:
    """An object with its picture, or several that are one style."""
    several = picture if isinstance(picture, list) else [picture]
    if not all(isinstance(each, str) and each for each in several) or not several:
        raise StyleSplatError(f"the style of {name} is no path: {picture!r}.")
    paths = tuple(path_in(folder, each) for each in several)
    if len(paths) > 1 and any("," in str(path) for path in paths):
        raise StyleSplatError(f"a picture of {name} has a comma in its path. Rename it.")
    word = f"{name}={','.join(map(str, paths))}"
    return Choice((word,), ((name, paths),), paths)


def _both(one: Choice, other: Choice) -> Choice:
    return Choice(one.words + other.words, one.shown + other.shown, one.inputs + other.inputs)


def _word(name: str, value: Any) -> str:
    if isinstance(value, bool):  # what YAML makes of words that options have
        return "on" if value else "off"
    if not isinstance(value, str | int | float):
        raise StyleSplatError(f"{name} takes no such value: {value!r}.")
    return str(value)


def _check_place(name: str, word: str) -> None:
    if Path(word).name != word or word.startswith("."):
        raise StyleSplatError(
            f"{name} is a name in the job's own folder, without folders, not {word!r}."
        )

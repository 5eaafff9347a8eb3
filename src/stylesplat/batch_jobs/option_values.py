"""The values of options in a job file, and the names of results that are made from them."""

import os
import re
from collections.abc import Sequence
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

from stylesplat.batch_jobs.job import JobOption, OptionValue
from stylesplat.errors import StyleSplatError, brief

ADDRESS = re.compile(r"[A-Za-z][\w+.-]+:/")  # a scheme is longer than the letter of a drive
LONGEST = 120  # characters of a name: file systems take 255 bytes, and suffixes are appended
UNFIT = re.compile(r"[^\w.+~]+")  # characters that names of results do not have
STYLE = "style"  # the option that is OBJECT=IMAGE on the command line, and a map in a job file


def refuse_address(path: str | Path) -> None:
    """Raise a StyleSplatError for an address such as `s3://bucket/scene`."""
    if ADDRESS.match(str(path)):
        raise StyleSplatError(
            f"{brief(str(path))!r} is an address, and jobs read and write files. Mount it "
            "(docs/batch.md says how), or copy it to a disk."
        )


def absolute_path(folder: Path, text: str) -> Path:
    """A path of a job file, which is relative to the folder of that file."""
    refuse_address(text)
    return Path(os.path.abspath(folder / text))  # noqa: PTH100 - resolve() would follow links


def option_values(name: str, option: JobOption, value: Any, folder: Path) -> list[OptionValue]:
    """The values that an option takes in turn: a list in the file stands for each of its items.

    Options that take several values have them in a list of their own, within that list.

    Raises:
        StyleSplatError: If the option does not take such a value.
    """
    values = value if isinstance(value, list) else [value]
    if not values:
        raise StyleSplatError(f"{name} lists nothing. Leave it out.")
    if name == STYLE:
        return [each for styles in values for each in _styles(styles, folder)]
    return [_option_value(name, option, each, folder) for each in values]


def _option_value(name: str, option: JobOption, value: Any, folder: Path) -> OptionValue:
    if value is None:
        return OptionValue(None, ((name, ("default",)),))
    if option.count == 0:
        if not isinstance(value, bool):
            raise StyleSplatError(f"{name} is true or false, not {value!r}.")
        return OptionValue((), ((name, ()),)) if value else OptionValue(None, (("no", (name,)),))
    if isinstance(value, list) and option.count == 1 and not option.repeated:
        raise StyleSplatError(f"{name} takes one value; a list within a list has no meaning.")
    values = value if isinstance(value, list) else [value]
    if isinstance(option.count, int) and not option.repeated and len(values) != option.count:
        raise StyleSplatError(
            f"{name} takes {option.count} values: write [[{', '.join('x' * option.count)}]], for "
            "a list alone stands for each of its items in turn."
        )
    words = tuple(_word(name, each) for each in values)
    if option.is_output:
        for word in words:
            if Path(word).name != word or word.startswith("."):
                raise StyleSplatError(
                    f"{name} is a name in the job's own folder, without folders, not {word!r}."
                )
        return OptionValue(words, (("", words),))
    if not option.is_path:
        return OptionValue(words, ((name, words),))
    paths = tuple(absolute_path(folder, word) for word in words)
    return OptionValue(tuple(map(str, paths)), ((name, paths),))


def _word(name: str, value: Any) -> str:
    if isinstance(value, bool):  # YAML reads `on` and `off` as booleans
        return "on" if value else "off"
    if not isinstance(value, str | int | float):
        raise StyleSplatError(f"{name} takes no such value: {value!r}.")
    return str(value)


def _styles(value: Any, folder: Path) -> list[OptionValue]:
    """The values of a map of objects and pictures, whose lists multiply."""
    if not isinstance(value, dict) or not value:
        raise StyleSplatError("style is a map: write {vase: wave.jpg}.")
    axes = []
    for name, pictures in value.items():
        several = pictures if isinstance(pictures, list) else [pictures]
        if not several:
            raise StyleSplatError(f"style lists no pictures for {name}.")
        axes.append([_style(name, picture, folder) for picture in several])
    return [
        OptionValue(
            words=tuple(word for word, _ in styles),
            parts=tuple((name, paths) for name, (_, paths) in zip(value, styles, strict=True)),
        )
        for styles in product(*axes)
    ]


def _style(name: str, picture: Any, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """An object with one picture, or with several that are one style."""
    several = picture if isinstance(picture, list) else [picture]
    if not all(isinstance(each, str) and each for each in several) or not several:
        raise StyleSplatError(f"the style of {name} is no path: {picture!r}.")
    paths = tuple(absolute_path(folder, each) for each in several)
    if len(paths) > 1 and any("," in str(path) for path in paths):
        raise StyleSplatError(f"a picture of {name} has a comma in its path. Rename it.")
    return f"{name}={','.join(map(str, paths))}", paths


def name_parts(values: Sequence[OptionValue]) -> list[str]:
    """The shortest texts that tell the values of an option apart; empty for a single value.

    Example:
        >>> wave, night, other = Path("a/wave.jpg"), Path("a/night.jpg"), Path("b/wave.jpg")
        >>> vase = lambda path: OptionValue((), (("vase", (path,)),))
        >>> name_parts([vase(wave), vase(night)])
        ['vase-wave', 'vase-night']
        >>> name_parts([vase(wave), vase(other)])
        ['vase-a-wave.jpg', 'vase-b-wave.jpg']
    """
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


def result_name(*parts: str) -> str:
    """A name of a folder that all file systems take.

    Example:
        >>> result_name("my garden", "stylize", "", "vase-wave", "scale-2.0")
        'my-garden-stylize-vase-wave-scale-2.0'
    """
    whole = "-".join(part for part in parts if part)
    name = UNFIT.sub("-", whole).strip("-.") or "job"
    if len(name) <= LONGEST and len(name.encode()) <= 2 * LONGEST:
        return name
    return f"{name[: LONGEST // 2]}~{sha256(whole.encode()).hexdigest()[:12]}"

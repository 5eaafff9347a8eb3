"""Names of files as another machine wrote them: backslashes, other folders, other upper case."""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

from stylesplat.errors import brief
from stylesplat.progress import say

Listed = Callable[[Path], dict[str, list[str]]]


class _Match(NamedTuple):
    path: Path
    dropped: int
    """How many leading parts of the name were left out to find the file."""


def find_files(
    folder: Path, names: Sequence[str], what: str, *, suffixes: Sequence[str] = ()
) -> list[Path]:
    """Find the files that names within a folder stand for, each also with one of the suffixes.

    A name that leads elsewhere, as a path of another machine does, stands for the file in the
    folder that has the longest end of it, if no other name stands for that file; a line says so.
    For a file that is not there the result is the path where it is expected.
    """
    listed = cache(_listed)
    found = {name: _find(folder, name, suffixes, listed) for name in dict.fromkeys(names)}
    owners = Counter(match.path for match in found.values() if match)
    moved = {
        name: match
        for name, match in found.items()
        if match and match.dropped and owners[match.path] == 1
    }
    if moved:
        say(
            f"{len(moved)} of {len(found)} {what} lead elsewhere, such as "
            f"{brief(next(iter(moved)))}: read within {folder}."
        )
    dropped = Counter(match.dropped for match in moved.values()).most_common(1)
    expected = partial(_expected, folder, dropped=dropped[0][0] if dropped else 0)
    return [
        match.path if (match := found[name]) and (name in moved or not match.dropped) else path
        for name, path in zip(names, map(expected, names), strict=True)
    ]


def _parts(name: str) -> list[str]:
    """The parts of a name of any system, without its drive and without dots."""
    path = _plain(name)
    return [part for part in path.parts if part not in (path.anchor, "..")]


def _plain(name: str) -> PureWindowsPath:
    return PureWindowsPath(os.path.normpath(name.replace("\\", "/")))


def _find(folder: Path, name: str, suffixes: Sequence[str], listed: Listed) -> _Match | None:
    for path in (folder / name, folder / name.replace("\\", "/")):
        exact = [Path(f"{path}{suffix}") for suffix in ("", *suffixes)]
        if there := [each for each in exact if os.path.isfile(each)]:  # noqa: PTH113 - any name
            return _Match(there[0], 0)
    parts = _parts(name)
    for start in range(len(parts)):
        if path := _match(folder, parts[start:], suffixes, listed):
            return _Match(path, start)
    return None


def _match(
    folder: Path, parts: Sequence[str], suffixes: Sequence[str], listed: Listed
) -> Path | None:
    """The file with this name within a folder, in any case if that leaves one."""
    for suffix in ("", *suffixes):
        place: Path | None = folder
        for part in (*parts[:-1], parts[-1] + suffix):
            entries = listed(place).get(part.casefold(), [])
            exact = [entry for entry in entries if entry == part] or entries
            place = place / exact[0] if place and len(exact) == 1 else None
            if place is None:
                break
        if place is not None and place.is_file():
            return place
    return None


def _listed(folder: Path) -> dict[str, list[str]]:
    """The entries of a folder by their name in lower case; none of what is no folder."""
    entries = dict[str, list[str]]()
    try:
        for entry in os.listdir(folder):  # noqa: PTH208 - names only
            entries.setdefault(entry.casefold(), []).append(entry)
    except OSError:
        pass
    return entries


def _expected(folder: Path, name: str, *, dropped: int) -> Path:
    """Where a file that is not there would be, if it lay like those that were found."""
    parts = _parts(name)
    is_foreign = _plain(name).anchor or ".." in _plain(name).parts
    if not is_foreign and not dropped:
        return folder / name.replace("\\", "/")
    return folder.joinpath(*(parts[dropped:] or parts[-1:]))

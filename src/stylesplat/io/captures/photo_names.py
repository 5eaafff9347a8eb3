"""Where the photos of a reconstruction lie on this machine, whatever another one called them."""

import os
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import takewhile
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from stylesplat.errors import shorten
from stylesplat.io.captures.posed_files import leaves
from stylesplat.io.files import is_file
from stylesplat.io.kinds import NO_PHOTOS, PHOTOS
from stylesplat.progress import say

# Where photos lie in a capture, the usual places first
USUAL_PHOTO_PLACES = (
    "images",
    "images_*",
    "input",
    "dense/images",
    "dense/*/images",
    "colmap/images",
    ".",
)


@dataclass(frozen=True)
class FoundPhotos:
    folder: Path
    names: dict[str, str]
    """By the name that poses use, the photo's path in the folder."""

    @property
    def renamed(self) -> dict[str, str]:
        """Those that are called otherwise, not only from another folder or with backslashes."""
        return {old: new for old, new in self.names.items() if not _slashed(old).endswith(new)}

    def within(self, places: Sequence[Path]) -> "FoundPhotos":
        """The same photos, named within their usual folder: `images/a.jpg` becomes `a.jpg`.

        In other folders they keep the names that they have, or have no folder in common.
        """
        paths = [self.folder / new for new in self.names.values()]
        inner = [p for p in places if paths and all(path.is_relative_to(p) for path in paths)]
        folder = max([self.folder, *inner], key=lambda place: len(place.parts))
        kept = any(_slashed(old) == new for old, new in self.names.items())
        if paths and folder == places[-1] and not kept:
            folder = Path(os.path.commonpath([path.parent for path in paths]))
        names = zip(self.names, paths, strict=True)
        return FoundPhotos(folder, {old: p.relative_to(folder).as_posix() for old, p in names})


def find_photos(folder: Path, names: Sequence[str], model: Path) -> FoundPhotos:
    """Find the posed photos in the folder of a capture that has most of them.

    A file fits a name with other folders above it, in another case or with another extension, if it
    is the only such file; so names may come from another machine. Photos beside the folder of the
    `model` are preferred.
    """
    beside = folder.joinpath(*takewhile("sparse".__ne__, model.relative_to(folder).parts))
    places = sorted(photo_places(folder), key=lambda place: place.parent != beside)
    best = FoundPhotos(places[-1], {})
    for match in (_exact, _alike):  # the first touches no other file than those that are named
        for place in places:
            found = FoundPhotos(place, match(place, names))
            best = max(best, found, key=lambda each: len(each.names))
            if len(best.names) == len({*names}):
                return best.within(places)
    return best.within(places)


def photo_places(folder: Path) -> list[Path]:
    """The folders in a capture that may hold its photos: the usual one first, itself last."""
    found = (path for place in USUAL_PHOTO_PLACES for path in _sorted(folder, place))
    return [path for path in found if path.is_dir()]


def photo_files(folder: Path) -> list[str]:
    """The photos in a folder and below, without folders of masks and the like; sorted."""
    found = list[str]()
    for place, folders, files in os.walk(folder):
        folders[:] = [f for f in folders if f.casefold() not in NO_PHOTOS and not f.startswith(".")]
        paths = (Path(place, file) for file in files if file.lower().endswith(PHOTOS))
        found += [path.relative_to(folder).as_posix() for path in paths if is_file(path)]
    return sorted(found)


def _sorted(folder: Path, place: str) -> Iterable[Path]:
    if place == "images_*":  # the least reduced copies first
        copies = [p for p in folder.glob(place) if p.name[7:].isdecimal()]
        return sorted(copies, key=lambda p: int(p.name[7:]))
    return sorted(folder.glob(place)) if "*" in place else [folder / place]


def _exact(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """The names that are paths in the folder."""
    found = dict[str, str]()
    for name in names:
        for text in dict.fromkeys((name, _slashed(name))):
            if not leaves(text) and os.path.lexists(folder / text):
                found[name] = PurePosixPath(text).as_posix()
                break
    return found


def _alike(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """The names with the only file that fits each."""
    found = _exact(folder, names)
    taken, by_stem = {*found.values()}, defaultdict[str, list[str]](list)
    for file in photo_files(folder):
        if file not in taken:
            by_stem[next(_keys(file))].append(file)
    chosen = {name: _best(name, by_stem) for name in dict.fromkeys(names) if name not in found}
    claims = Counter(chosen.values())
    return found | {name: file for name, file in chosen.items() if file and claims[file] == 1}


def _best(name: str, by_stem: dict[str, list[str]]) -> str | None:
    """The file that has more in common with a name than any other has."""
    keys = [*_keys(name)]
    ranked = defaultdict[tuple[int, bool], list[str]](list)
    for file in by_stem.get(keys[0], ()) if keys else ():
        others = [*_keys(file)]
        pairs = zip(keys, others, strict=False)
        same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
        if same == min(len(keys), len(others)):  # one is the end of the other
            alike = _suffix(name).casefold() == _suffix(file).casefold()
            ranked[same, alike].append(file)
    best = ranked[max(ranked)] if ranked else []
    return best[0] if len(best) == 1 else None


def _keys(name: str) -> Iterator[str]:
    """What identifies a photo: its stem, then the folders above it, from the lowest one."""
    path = PurePosixPath(_slashed(name))
    if path.name:
        parts = (path.name.removesuffix(_suffix(name)), *path.parts[-2::-1])
        yield from (unicodedata.normalize("NFC", part).casefold() for part in parts)


def _suffix(name: str) -> str:
    """The extension, if it is one of photos: `frame.01` has none."""
    suffix = PurePosixPath(_slashed(name)).suffix
    return suffix if suffix.lower() in PHOTOS else ""


def _slashed(name: str) -> str:
    """A name with the separators of all systems but Windows."""
    return name.replace("\\", "/")


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
            f"{shorten(next(iter(moved)))}: read within {folder}."
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
    return PureWindowsPath(os.path.normpath(_slashed(name)))


def _find(folder: Path, name: str, suffixes: Sequence[str], listed: Listed) -> _Match | None:
    for path in (folder / name, folder / _slashed(name)):
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
        return folder / _slashed(name)
    return folder.joinpath(*(parts[dropped:] or parts[-1:]))

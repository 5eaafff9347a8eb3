"""Which photos the files of another program are about, as their names say."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from stylesplat.errors import StyleSplatError


def photo_key(name: str) -> str:
    """A photo's path without its suffix, which is what files about it are called.

    Example:
        >>> photo_key("cam0/IMG_0007.jpg")
        'cam0/IMG_0007'
    """
    return PurePosixPath(name).with_suffix("").as_posix()


def match_photos(keys: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """The photo that each file is about; files about none are left out.

    That is the photo whose path the file's ends with. If there is none, the file's bare name
    tells, as long as it lies in no folder of photos and only one photo has that name.

    Args:
        keys: The files' paths without suffix.
        names: The photos' names.

    Raises:
        StyleSplatError: If two files are about one photo, or a file is about one of several of
            which not all have another.
    """
    known = _Known.of(names)
    by_path = {key: known.by_path(key) for key in keys}
    matches = {key: photos[0] for key, photos in by_path.items() if len(photos) == 1}
    taken = {*matches.values()}
    for key in [key for key in by_path if key not in matches]:
        photos = by_path[key] or known.by_stem(key)
        left = [photo for photo in photos if photo not in taken]
        if left and len(photos) > 1:
            raise StyleSplatError(
                f"The mask {key} may be of {photos[0]} or of {photos[1]}. Name masks like the "
                f"photos, with their folders: {photo_key(left[0])}.png."
            )
        if left:
            matches[key] = left[0]
    _refuse_twice(matches)
    return matches


@dataclass(frozen=True)
class _Known:
    """Photos by what tells them."""

    paths: Mapping[str, list[str]]
    """Without suffix."""
    stems: Mapping[str, list[str]]
    """Without suffix and folder."""
    folders: frozenset[str]
    """That they lie in."""

    @classmethod
    def of(cls, names: Sequence[str]) -> "_Known":
        paths: dict[str, list[str]] = {}
        stems: dict[str, list[str]] = {}
        for name in names:
            key = photo_key(name)
            paths.setdefault(key, []).append(name)
            stems.setdefault(PurePosixPath(key).name, []).append(name)
        folders = {PurePosixPath(name).parent.as_posix() for name in names}
        return cls(paths, stems, frozenset(folders - {"."}))

    def by_path(self, key: str) -> list[str]:
        """The photos whose path is the longest end of a file's."""
        return next((self.paths[end] for end in _ends(key) if end in self.paths), [])

    def by_stem(self, key: str) -> list[str]:
        """The photos that share a file's bare name; none if its folder is one of photos."""
        *folder, stem = PurePosixPath(key).parts
        strict = any(end in self.folders for end in _ends("/".join(folder)))
        return [] if strict else self.stems.get(stem, [])


def _ends(path: str) -> list[str]:
    parts = PurePosixPath(path).parts
    return ["/".join(parts[start:]) for start in range(len(parts))]


def _refuse_twice(matches: Mapping[str, str]) -> None:
    keys: dict[str, str] = {}
    for key, photo in matches.items():
        if photo in keys:
            raise StyleSplatError(
                f"Both {keys[photo]} and {key} are named like {photo}. Give the folder of one kind."
            )
        keys[photo] = key

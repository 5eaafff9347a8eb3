"""The files of a folder of photos, and what each is to be called."""

import importlib.util
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path, PurePosixPath

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.captures.capture_folder import EXACT, OBJECT_MASK
from stylesplat.io.captures.posed_files import check_path
from stylesplat.io.kinds import HEIC, PHOTOS, TRANSFORMS, VIDEOS, find_sparse
from stylesplat.structure_from_motion.ordering import natural_key

RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".pef", ".srw")
# Folders of pictures that are no photos of the scene
SKIPPED = (
    OBJECT_MASK,
    EXACT,
    "object_masks",
    "mask",
    "masks",
    "sparse",
    "depth",
    "depths",
    "thumbs",
)
UNFINISHED = ".partial"


@dataclass(frozen=True)
class Found:
    """What a folder holds."""

    photos: tuple[str, ...]
    """Paths within the folder, in natural order, with `/` between the parts."""
    videos: tuple[str, ...]
    """The same."""
    left_out: dict[str, str]
    """The same of photos that cannot be used, and why."""


def find_sources(folder: Path, *, skip: Path) -> Found:
    """Look through a folder and all within it, but for what is hidden or made by programs.

    Args:
        folder: Where to look.
        skip: A folder within that is ours.

    Raises:
        StyleSplatError: If the folder is a capture that has its poses, or cannot be read, or HEIC
            files are in it and nothing that reads them is installed.
    """
    _refuse_posed(folder)
    names = sorted(_walk(folder, skip), key=natural_key)
    left_out = {name: fault for name in names if (fault := _fault(name))}
    photos = tuple(name for name in _ending(names, PHOTOS) if name not in left_out)
    heic = _ending(photos, HEIC)
    if heic and importlib.util.find_spec("pillow_heif") is None:
        raise StyleSplatError(
            f"{brief(heic[0])} is HEIC, as are {len(heic)} of {len(photos)} photos of {folder}. "
            "`pip install 'stylesplat[heic]'` makes them readable."
        )
    return Found(photos, _ending(names, VIDEOS), left_out)


def written_names(photos: tuple[str, ...], suffixes: tuple[str, ...]) -> tuple[str, ...]:
    """What photos are called once written: their own names, with the suffix of what is written.

    Label maps are called like photos without suffix, so names differ without it, and also where
    case is lost.

    Args:
        photos: Their paths.
        suffixes: What each gets if its own is not of that kind.

    Example:
        >>> written_names(("a b/1.HEIC", "a b/1.jpg", "2.JPG"), (".jpg", ".jpg", ".jpg"))
        ('a b/1.jpg', 'a b/1_jpg.jpg', '2.JPG')
    """
    taken: set[str] = set()
    return tuple(map(lambda name, suffix: _written(name, suffix, taken), photos, suffixes))


def _written(name: str, suffix: str, taken: set[str]) -> str:
    own = PurePosixPath(name).suffix
    stem = name.removesuffix(own)
    kind = own if own.lower() in (suffix, suffix.replace("jpg", "jpeg")) else suffix
    numbered = (f"{stem}_{number}" for number in count(2))
    choices = chain((stem, f"{stem}_{own[1:].lower()}"), numbered)
    free = next(choice for choice in choices if choice.casefold() not in taken)
    taken.add(free.casefold())
    return free + kind


def _refuse_posed(folder: Path) -> None:
    posed = TRANSFORMS if (folder / TRANSFORMS).is_file() else None
    posed = posed or ("sparse" if (folder / "sparse").is_dir() and find_sparse(folder) else None)
    if posed:
        photos = f", or give {folder / 'images'} to find new ones" * (folder / "images").is_dir()
        raise StyleSplatError(
            f"{folder} has its poses already ({posed}). Use it as it is, with "
            f"`stylesplat train {folder}`{photos}."
        )


def _walk(folder: Path, skip: Path) -> Iterator[str]:
    ours = skip.resolve()

    def fail(error: OSError) -> None:
        raise StyleSplatError(f"Cannot read {error.filename}: {error.strerror}.") from error

    for place, folders, files in os.walk(folder, onerror=fail):
        here = Path(place)
        folders[:] = [f for f in folders if not _is_skipped(f) and (here / f).resolve() != ours]
        inside = [here / file for file in files if not _is_skipped(file)]
        yield from (path.relative_to(folder).as_posix() for path in inside if path.is_file())


def _is_skipped(name: str) -> bool:
    hidden = name.startswith((".", "__MACOSX", "@eaDir"))
    return hidden or name.endswith(UNFINISHED) or name.casefold() in SKIPPED


def _fault(name: str) -> str | None:
    if name.lower().endswith(RAW):
        return "a raw file; give JPEG"
    if not name.lower().endswith(PHOTOS):
        return None
    try:
        check_path(name)
    except StyleSplatError:
        return "its name is none that other programs read; rename it"
    return None


def _ending(names: tuple[str, ...] | list[str], suffixes: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in names if name.lower().endswith(suffixes))

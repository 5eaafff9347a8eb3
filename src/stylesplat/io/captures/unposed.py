"""Photos of a capture that have no pose."""

from collections.abc import Collection
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import find_photos
from stylesplat.io.captures.sfm_file import read_sfm
from stylesplat.io.kinds import PHOTOS


def unposed_photos(folder: Path, posed: Collection[str]) -> tuple[dict[str, str], int]:
    """Find them, by what `sfm` wrote down; else they are the others in the folder of photos.

    Args:
        folder: The capture.
        posed: Names of the photos that have a pose.

    Returns:
        By name why, which may be empty; and how many photos were not tried.

    Raises:
        StyleSplatError: If what `sfm` wrote is damaged.
    """
    record = read_sfm(folder)
    if record is not None:
        return dict(record.unregistered), len(record.left_out)
    return dict.fromkeys(photos_besides(folder, posed), ""), 0


def photos_besides(folder: Path, posed: Collection[str]) -> list[str]:
    """The names of the other photos that lie where those of a capture do, in order."""
    try:
        photos = find_photos(folder)
    except StyleSplatError:  # those of transforms.json may lie anywhere
        return []
    files = (path for path in sorted(photos.rglob("*")) if path.suffix.lower() in PHOTOS)
    names = {path.relative_to(photos).as_posix() for path in files if path.is_file()}
    if not names & set(posed):  # these are named within another folder
        return []
    return sorted(names - set(posed))

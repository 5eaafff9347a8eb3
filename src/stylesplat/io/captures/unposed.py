"""Photos of a capture that have no pose."""

from collections.abc import Collection
from pathlib import Path

from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import find_photos
from stylesplat.io.captures.decoding import FORMATS
from stylesplat.io.captures.sfm_file import read_sfm


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
    try:
        photos = find_photos(folder)
    except StyleSplatError:  # those of transforms.json may lie anywhere
        return {}, 0
    suffixes = {s for s, kind in Image.registered_extensions().items() if kind in FORMATS}
    files = (path for path in sorted(photos.rglob("*")) if path.suffix.lower() in suffixes)
    names = {path.relative_to(photos).as_posix() for path in files if path.is_file()}
    if not names & set(posed):  # these are named within another folder
        return {}, 0
    return dict.fromkeys(sorted(names - set(posed)), ""), 0

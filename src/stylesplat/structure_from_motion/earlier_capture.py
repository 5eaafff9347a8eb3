"""The capture that was made of photos or a video earlier: its place, and its names of photos.

torch is loaded only when it is needed.
"""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import progress_path
from stylesplat.io.files import is_file, is_there, real_path

if TYPE_CHECKING:
    from stylesplat.io.captures.capture_folder import SfmRecord

SUFFIX = "-capture"  # after the name of the photos' folder


def source_digest(source: Path) -> str:
    """SHA-256 of the names and sizes of the photos and videos."""
    from stylesplat.structure_from_motion.photos import find_sources

    folder, names = source.parent, [source.name]
    if source.is_dir():
        found = find_sources(source, skip=progress_path(source))
        folder, names = source, [*found.photos, *found.videos]
    state = hashlib.sha256()
    for name in names:
        state.update(f"{name}\0{(folder / name).stat().st_size}\0".encode(errors="replace"))
    return state.hexdigest()


def capture_place(given: Path, *, beside: Path) -> Path:
    """The folder for the capture of photos or a video, which is never among the photos."""
    own, folder = real_path(given), real_path(beside).parent
    if folder.is_relative_to(own):
        folder = own.parent
    return folder / f"{own.stem if is_file(own) else own.name}{SUFFIX}"


def find_earlier_capture(given: Path, *, beside: Path) -> Path | None:
    """The capture that was made of photos or a video; an error if these have changed since."""
    from stylesplat.io.captures.capture_folder import read_sfm

    stale = None
    for place in dict.fromkeys(capture_place(given, beside=near) for near in (given, beside)):
        record = read_sfm(place)
        if record is not None and Path(record.source) == given.resolve():
            if record.digest == source_digest(given):
                return place
            stale = place
    if stale is None:
        return None
    raise StyleSplatError(
        f"The photos in {given} have changed since {stale} was made of them. Make it again with "
        f"`stylesplat sfm {given} -o {stale} --overwrite` (its label maps are kept), or use it as "
        "it is: name it in place of the photos."
    )


def is_sfm_unfinished(given: Path, *, beside: Path) -> bool:
    """Whether an interrupted `sfm` of these photos would be continued."""
    return is_there(progress_path(capture_place(given, beside=beside)) / "sfm")


def view_of_photo(name: str, record: "SfmRecord | None") -> str:
    """The name in a capture of a photo that the user knows by its own name."""
    if record is None:
        return name
    unposed = record.left_out | record.unregistered
    views = {own: view for view, own in record.origins.items()}
    if name not in unposed | views:
        alike = [own for own in unposed | views if Path(own).with_suffix("").as_posix() == name]
        name = alike[0] if len(alike) == 1 else name
    if name in unposed:
        raise StyleSplatError(f"The photo {name} has no pose: {unposed[name]}. Take another one.")
    return views.get(name, name)

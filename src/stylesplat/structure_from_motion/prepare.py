"""From a folder of photos or a video to upright photos that poses can be found for."""

import hashlib
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import partial_of
from stylesplat.io.files import inside, require_regular
from stylesplat.io.json_files import read_json_as, write_json
from stylesplat.io.kinds import PHOTOS
from stylesplat.structure_from_motion.config import MIN_PHOTOS
from stylesplat.structure_from_motion.photo_files import map_photos, write_photo
from stylesplat.structure_from_motion.photo_folder import (
    RAW,
    PreparedPhotos,
    SourceFiles,
    find_sources,
    select_photos,
    too_few_photos,
)
from stylesplat.structure_from_motion.video_keyframes import (
    open_video,
    select_keyframes,
    write_keyframes,
)

RECORD = ".prepared.json"  # in the folder of prepared photos
VERSION = 3  # of how photos are selected and written; those of another version are made again


def check_source(source: Path) -> None:
    """Refuse what is clearly neither photos nor a video, before anything is written."""
    found = _open_source(source, partial_of(source), MIN_PHOTOS)
    if found.files is None:
        with open_video(found.path):
            pass


def prepare(source: Path, folder: Path, *, frames: int = 100) -> PreparedPhotos:
    """Write photos that are fit for structure from motion: sharp, upright, none twice.

    What the folder holds is deleted, but for photos that an earlier call wrote of the same source.
    """
    if frames < MIN_PHOTOS:
        raise StyleSplatError(f"Cannot choose {frames} frames. Give {MIN_PHOTOS} or more.")
    found = _open_source(Path(source), folder := Path(folder), frames)
    record, identity = _read_record(folder), found.identity()
    if record is None or record.source != identity:
        record = _Record(identity, found.select())
        shutil.rmtree(folder, ignore_errors=True)
        write_json(asdict(record), folder / RECORD)
    origins = record.prepared.origins
    found.write({n: o for n, o in origins.items() if not inside(folder, n).is_file()}, folder)
    return record.prepared


@dataclass(frozen=True)
class _Source:
    path: Path
    files: SourceFiles | None
    frames: int

    def identity(self) -> str:
        """A digest that differs for other files and other settings."""
        if self.files is None:
            parts = [str(self.frames), _stamp(self.path)]
        else:
            photos = [f"{name} {_stamp(inside(self.path, name))}" for name in self.files.photos]
            parts = [*photos, *self.files.left_out, *self.files.videos]
        text = "\n".join((str(VERSION), *parts))
        return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()

    def select(self) -> PreparedPhotos:
        if self.files is None:
            return select_keyframes(self.path, self.frames)
        return select_photos(self.path, self.files)

    def write(self, origins: dict[str, str], folder: Path) -> None:
        """Write photos, given by name with what the user calls them."""
        if self.files is None:
            write_keyframes(self.path, [*origins], folder)
            return

        def write(item: tuple[str, str]) -> None:
            name, origin = item
            write_photo(inside(self.path, origin), inside(folder, name))

        map_photos(write, origins.items(), "writing photos")


def _open_source(source: Path, folder: Path, frames: int) -> _Source:
    if source.is_dir():
        files = find_sources(source, skip=folder)
        if files.photos:
            return _Source(source, files, frames)
        if not files.videos:
            raise too_few_photos(source, 0, files.left_out)
        if len(files.videos) > 1:
            raise StyleSplatError(
                f"{source} holds {len(files.videos)} videos: {', '.join(files.videos)}. Give one."
            )
        return _Source(source.joinpath(*files.videos), None, frames)
    require_regular(source)
    if not source.exists():
        raise StyleSplatError(f"There is no folder or video {source}. Check the name.")
    if source.suffix.lower() in (*PHOTOS, *RAW):
        raise StyleSplatError(f"{source} is one photo. Give the folder of all photos, or a video.")
    return _Source(source, None, frames)


@dataclass(frozen=True)
class _Record:
    """What a folder of prepared photos holds, so that an interrupted call can continue."""

    source: str
    prepared: PreparedPhotos


def _read_record(folder: Path) -> _Record | None:
    """The record of an earlier call; None if there is none, or it is damaged."""
    try:
        return read_json_as(folder / RECORD, _Record, "It is made again.")
    except StyleSplatError:
        return None


def _stamp(path: Path) -> str:
    """Size and time of a file, which differ once it was changed."""
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns}"

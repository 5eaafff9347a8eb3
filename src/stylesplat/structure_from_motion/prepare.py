"""From a folder of photos or a video to upright photos that poses can be found for."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import partial_of
from stylesplat.io.files import inside, require_regular
from stylesplat.io.kinds import PHOTOS
from stylesplat.progress import track
from stylesplat.structure_from_motion.photo_choice import THREADS, choose_photos, too_few
from stylesplat.structure_from_motion.photo_folder import RAW, Found, find_sources
from stylesplat.structure_from_motion.photo_writing import write_photo
from stylesplat.structure_from_motion.prepared import LEAST, Prepared
from stylesplat.structure_from_motion.record import (
    Record,
    clear,
    digest,
    read_record,
    stamp,
    write_record,
)
from stylesplat.structure_from_motion.video_frames import choose_frames, write_frames
from stylesplat.structure_from_motion.video_reading import opened_video


def check_source(source: Path) -> None:
    """Refuse what is clearly neither photos nor a video, before anything is written.

    Raises:
        StyleSplatError: If it is neither a folder with photos or one video, nor a video, or cannot
            be read.
    """
    found = _source(source, partial_of(source), LEAST)
    if isinstance(found, _Video):
        with opened_video(found.file):
            pass


def prepare(source: Path, folder: Path, *, frames: int = 100) -> Prepared:
    """Write photos that are fit for structure from motion: sharp, upright, none twice.

    What an earlier call wrote stays if its source is the same; what it wrote from others goes.

    Args:
        source: A folder of photos, sub-folders included, or with one video, or a video.
        folder: Where to, a folder of nothing else; the user's photos are linked or copied there.
        frames: How many to take of a video at most.

    Raises:
        StyleSplatError: If there are fewer than 3 photos that can be used, the source has its
            poses already or is neither photos nor a video, or the folder holds anything else or
            cannot be written to.
    """
    if frames < LEAST:
        raise StyleSplatError(f"Cannot choose {frames} frames. Give {LEAST} or more.")
    found = _source(Path(source), folder := Path(folder), frames)
    earlier = read_record(folder)
    identity = found.identity()
    if earlier and earlier.source == identity:
        record = earlier
    else:
        prepared = found.choose()
        stamps = {name: found.stamp(origin) for name, origin in prepared.origins.items()}
        record = Record(source=identity, prepared=prepared, stamps=stamps)
    clear(folder, record, earlier)
    if record is not earlier:
        write_record(record, folder)
    done = {name for name in record.stamps if inside(folder, name).is_file()}
    found.write(
        {n: origin for n, origin in record.prepared.origins.items() if n not in done}, folder
    )
    return record.prepared


@runtime_checkable
class _Source(Protocol):
    """What photos are made of."""

    def identity(self) -> str:
        """Another one for other files, or other settings."""
        ...

    def choose(self) -> Prepared:
        """Look at all of it."""
        ...

    def stamp(self, origin: str) -> str:
        """Another one for another file that a photo is made of."""
        ...

    def write(self, origins: dict[str, str], folder: Path) -> None:
        """Write photos, by name what the user calls them."""
        ...


@dataclass(frozen=True)
class _Photos:
    folder: Path
    found: Found

    def identity(self) -> str:
        return digest(*map(self.stamp, self.found.photos), *self.found.left_out, *self.found.videos)

    def choose(self) -> Prepared:
        return choose_photos(self.folder, self.found)

    def stamp(self, origin: str) -> str:
        return f"{origin} {stamp(inside(self.folder, origin))}"

    def write(self, origins: dict[str, str], folder: Path) -> None:
        def one(item: tuple[str, str]) -> None:
            name, origin = item
            write_photo(inside(self.folder, origin), inside(folder, name))

        # Python's own filters are of the process: those that threads set would get mixed up
        with warnings.catch_warnings(action="ignore"), ThreadPoolExecutor(THREADS) as pool:
            written = pool.map(one, origins.items())
            try:
                for _ in track(written, "writing photos", unit="photo", total=len(origins)):
                    pass
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


@dataclass(frozen=True)
class _Video:
    file: Path
    frames: int

    def identity(self) -> str:
        return digest(self.stamp(""), str(self.frames))

    def choose(self) -> Prepared:
        return choose_frames(self.file, self.frames)

    def stamp(self, origin: str) -> str:
        return f"{origin} of {stamp(self.file)}"

    def write(self, origins: dict[str, str], folder: Path) -> None:
        write_frames(self.file, [*origins], folder)


def _source(source: Path, folder: Path, frames: int) -> _Source:
    if source.is_dir():
        return _in_folder(source, folder, frames)
    require_regular(source)
    if not source.exists():
        raise StyleSplatError(f"There is no folder or video {source}. Check the name.")
    if source.suffix.lower() in (*PHOTOS, *RAW):
        raise StyleSplatError(f"{source} is one photo. Give the folder of all photos, or a video.")
    return _Video(source, frames)


def _in_folder(source: Path, folder: Path, frames: int) -> _Source:
    if folder.resolve() == source.resolve():
        raise StyleSplatError(f"{folder} holds the photos themselves. Choose another folder.")
    found = find_sources(source, skip=folder)
    if found.photos:
        return _Photos(source, found)
    if len(found.videos) > 1:
        raise StyleSplatError(
            f"{source} holds {len(found.videos)} videos: {', '.join(found.videos)}. Give one."
        )
    if found.videos:
        return _Video(source / found.videos[0], frames)
    raise too_few(source, 0, "photos", found.left_out)

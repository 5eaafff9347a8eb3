"""From a folder of photos or a video to upright photos that poses can be found for."""

import hashlib
import shutil
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import progress_path
from stylesplat.io.files import require_regular, resolve_within
from stylesplat.io.json_yaml import read_json_as, write_json
from stylesplat.io.kinds import PHOTOS
from stylesplat.structure_from_motion.config import MIN_PHOTOS
from stylesplat.structure_from_motion.photos import (
    RAW,
    PreparedPhotos,
    SourceFiles,
    find_sources,
    map_photos,
    select_photos,
    too_few_photos,
    write_photo,
)
from stylesplat.structure_from_motion.video_keyframes import (
    open_video,
    select_keyframes,
    write_keyframes,
)

PREPARE_RECORD = ".prepared.json"  # in the folder of prepared photos
# Of how photos are selected and written; those of another version are made again
PREPARE_VERSION = 6


def check_source(source: Path) -> None:
    """Refuse what is clearly neither photos nor a video, before anything is written."""
    path, files = _find_source(source, progress_path(source))
    if files is None:
        with open_video(path):
            pass


def prepare(source: Path, folder: Path, *, frames: int = 100) -> PreparedPhotos:
    """Write photos that are fit for structure from motion: sharp, upright, none twice.

    What the folder holds is deleted, but for photos that an earlier call wrote of the same source.
    """
    if frames < MIN_PHOTOS:
        raise StyleSplatError(f"Cannot choose {frames} frames. Give {MIN_PHOTOS} or more.")
    path, files = _find_source(source, folder)
    if files is None:
        parts = [str(frames), _stamp(path)]
    else:
        photos = [f"{name} {_stamp(resolve_within(path, name))}" for name in files.photos]
        parts = [*photos, *files.left_out, *files.videos]
    text = "\n".join((str(PREPARE_VERSION), *parts))
    identity = hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()
    record = None
    with suppress(StyleSplatError):  # there is none, or it is damaged
        record = read_json_as(folder / PREPARE_RECORD, _Record, "It is made again.")
    if record is None or record.source != identity:
        chosen = select_keyframes(path, frames) if files is None else select_photos(path, files)
        record = _Record(identity, chosen)
        shutil.rmtree(folder, ignore_errors=True)
        write_json(asdict(record), folder / PREPARE_RECORD)
    prepared = record.prepared
    missing = {n: o for n, o in prepared.origins.items() if not resolve_within(folder, n).is_file()}

    def write(item: tuple[str, str]) -> None:
        name, origin = item
        write_photo(resolve_within(path, origin), resolve_within(folder, name))

    if files is None:
        write_keyframes(path, [*missing], folder)
    else:
        map_photos(write, missing.items(), "writing photos")
    return prepared


def _find_source(source: Path, folder: Path) -> tuple[Path, SourceFiles | None]:
    """The folder and its files, or the video and None."""
    if source.is_dir():
        files = find_sources(source, skip=folder)
        if files.photos:
            return source, files
        if not files.videos:
            raise too_few_photos(source, 0, files.left_out)
        if len(files.videos) > 1:
            raise StyleSplatError(
                f"{source} holds {len(files.videos)} videos: {', '.join(files.videos)}. Give one."
            )
        return source.joinpath(*files.videos), None
    require_regular(source)
    if not source.exists():
        raise StyleSplatError(f"There is no folder or video {source}. Check the name.")
    if source.suffix.lower() in (*PHOTOS, *RAW):
        raise StyleSplatError(f"{source} is one photo. Give the folder of all photos, or a video.")
    return source, None


@dataclass(frozen=True)
class _Record:
    """What a folder of prepared photos holds, so that an interrupted call can continue."""

    source: str
    prepared: PreparedPhotos


def _stamp(path: Path) -> str:
    """Size and time of a file, which differ once it was changed."""
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns}"

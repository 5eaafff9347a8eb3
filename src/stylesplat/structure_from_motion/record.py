"""What is in a folder of prepared photos, so that an interrupted call can go on."""

import hashlib
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import cannot_write, inside
from stylesplat.io.json_files import PhotoName, read_json_as, write_json
from stylesplat.structure_from_motion.prepared import Prepared

RECORD = ".prepared.json"
VERSION = 1  # of what is chosen and how it is written; what another one wrote is written anew


@dataclass(frozen=True)
class Record:
    """What photos were made of."""

    source: str
    """What identifies the source as a whole, and the settings."""
    prepared: Prepared
    """What came of it."""
    stamps: dict[PhotoName, str]
    """By name, what identifies the file that a photo is made of."""
    version: int = VERSION
    """Of the code that chose and wrote them."""


def read_record(folder: Path) -> Record | None:
    """What an earlier call wrote there; None if none did, or one of another version.

    Raises:
        StyleSplatError: If the folder is a file or holds something else.
    """
    if not (folder / RECORD).is_file():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise StyleSplatError(f"{folder} holds something else. Choose another folder.")
        return None
    try:
        record = read_json_as(folder / RECORD, Record, "It is made again.")
        for name in (*record.prepared.names, *record.prepared.origins, *record.stamps):
            inside(folder, name)
    except StyleSplatError:  # half a file, one of another version, or none of ours
        return None
    return record if record.version == VERSION else None


def write_record(record: Record, folder: Path) -> None:
    """Tell what will be in a folder, before it is written.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    write_json(asdict(record), folder / RECORD)


def clear(folder: Path, record: Record, earlier: Record | None) -> None:
    """Remove what a record does not tell of, or was made of other files than it tells.

    Raises:
        StyleSplatError: If a file cannot be removed.
    """
    stamps = earlier.stamps if earlier else {}
    kept = {RECORD, *(n for n, stamp in record.stamps.items() if stamps.get(n) == stamp)}
    try:
        for path in [*folder.rglob("*")]:
            if path.is_file() and path.relative_to(folder).as_posix() not in kept:
                path.unlink()
        for path in [p for p in folder.glob("*") if p.is_dir() and not any(_files(p))]:
            shutil.rmtree(path)
    except OSError as error:
        raise cannot_write(folder, error) from error


def stamp(path: Path) -> str:
    """What differs once a file has been changed: its size and when it was.

    Raises:
        StyleSplatError: If it is no longer there.
    """
    try:
        found = path.stat()
    except OSError as error:
        raise StyleSplatError(f"Cannot read {path}: {error.strerror}.") from error
    return f"{found.st_size} {found.st_mtime_ns}"


def digest(*texts: str) -> str:
    """What differs for other texts."""
    return hashlib.sha256("\n".join(texts).encode(errors="surrogateescape")).hexdigest()


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]

"""The files that make up a SOG: in a zip file, or beside a meta.json."""

import io
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import inside, read_bytes, reason
from stylesplat.io.kinds import SOG_META

MAX_META = 2**20  # bytes; three codebooks have 20,000
PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others cannot be unpacked within bounds
MAX_GROWTH = 4  # of what is unpacked: pictures are compressed already
DATE = (1980, 1, 1, 0, 0, 0)  # in every entry, so that the same splats make the same file

Members = Callable[[str], bytes]
"""The content of the file of a name."""


def sog_members(path: Path) -> Members:
    """Where to look for the files of a SOG: in a bundle, or beside its meta.json.

    Raises:
        StyleSplatError: If the file is missing or no zip file; the result raises it for names that
            are not there, lead elsewhere, or whose content is damaged or unpacks to too much.
    """
    return _beside(path) if path.name == SOG_META else _bundled(path)


def write_bundle(files: dict[str, bytes], path: Path) -> None:
    """Write a bundle, whole or not at all.

    Raises:
        StyleSplatError: If it cannot be written.
    """
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as bundle:
        for name, content in files.items():
            bundle.writestr(zipfile.ZipInfo(name, DATE), content)


def _beside(path: Path) -> Members:
    def member(name: str) -> bytes:
        place = inside(path.parent, name)
        return read_bytes(place, most=MAX_META if name == SOG_META else None)

    return member


def _bundled(path: Path) -> Members:
    content = read_bytes(path)
    try:
        bundle = zipfile.ZipFile(io.BytesIO(content))
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
        raise _cannot_read(path, f"it is no zip file ({reason(error)})") from error

    def member(name: str) -> bytes:
        most = MAX_META if name == SOG_META else MAX_GROWTH * len(content)
        try:
            return _unpacked(bundle, name, most)
        except KeyError as error:
            raise _cannot_read(path, f"there is no {brief(name)!r} in it") from error
        # What zipfile raises for encrypted entries is a RuntimeError
        except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError) as error:
            raise _cannot_read(path, f"{brief(name)!r}: {reason(error)}") from error

    return member


def _unpacked(bundle: zipfile.ZipFile, name: str, most: int) -> bytes:
    entry = bundle.getinfo(name)
    if entry.compress_type not in PLAIN:
        raise ValueError("it is packed in a way that the format has not")
    if entry.file_size > most:
        raise ValueError(f"it would unpack to {entry.file_size} bytes")
    with bundle.open(entry) as file:
        content = file.read(entry.file_size)  # and no more, whatever follows
        if len(content) != entry.file_size or file.read(1):
            raise ValueError("it is cut off")
    return content


def _cannot_read(path: Path, fault: str) -> StyleSplatError:
    return StyleSplatError(f"Cannot read {path}: {fault}. Export it again.")

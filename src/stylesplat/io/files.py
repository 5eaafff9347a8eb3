"""Files are written whole or not at all: to a temporary name beside the target, then renamed."""

import errno
import hashlib
import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from stylesplat.errors import StyleSplatError, brief

FICLONE = 0x40049409  # of Linux's <linux/fs.h>: a file that shares another's disk blocks
DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
ELSEWHERE = " Choose another place."
REPLACING = "`--overwrite` (in Python overwrite=True)"  # how one says that it may be replaced
REMEDIES = {  # other errors of writing
    errno.ENAMETOOLONG: " Choose a shorter name.",
    errno.EACCES: " Choose a place that this user may write to.",
    errno.EPERM: " Choose a place that this user may write to.",
    errno.EROFS: " Choose a place that can be written to.",
}
MARK = "[0-9a-f]{12}"  # what makes a hidden name one that nothing has: see `mark`
MAX_STEM = 48  # characters of a file name that are taken from a text
PLAIN = re.compile(f"[a-z0-9_-]{{1,{MAX_STEM}}}")


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """A path to write to, which becomes `path` if the block succeeds and vanishes if not.

    The temporary file lies in the same folder and keeps the suffix; folders are made as needed.
    It is on the disk before it gets its name, so a power cut leaves the old file or the new one.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    path = Path(path)
    temporary = beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        _sync_file(temporary)
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def copy_file(source: Path | str, target: Path | str) -> None:
    """Copy the bytes of a file; where the file system can, both share the disk until one changes.

    Raises:
        OSError: If the source cannot be read or the target not be written.
    """
    if not _cloned(Path(source), Path(target)):
        shutil.copyfile(source, target)


def _cloned(source: Path, target: Path) -> bool:
    if sys.platform != "linux":
        return False
    from fcntl import ioctl

    with source.open("rb") as old, target.open("wb") as new:
        try:
            ioctl(new.fileno(), FICLONE, old.fileno())
        except OSError:  # not on ext4, nor between file systems
            return False
    return True


def inside(folder: Path, name: str) -> Path:
    """The path of a name within a folder, for names that came from a file.

    Raises:
        StyleSplatError: If it lies elsewhere, be it by way of a sub-folder that is a link.
    """
    path = folder / name
    here, there = folder.resolve(), path.parent.resolve()
    if path.name in ("", "..") or not there.is_relative_to(here):
        raise StyleSplatError(
            f"{brief(name)!r} leads out of the folder {folder}. Rename it, or remove the link."
        )
    return path


def require_regular(path: Path | str) -> None:
    """Raise a StyleSplatError for what is there but no file: to read a pipe may never end."""
    try:
        other = Path(path).exists() and not Path(path).is_file()
    except OSError as error:
        raise cannot_read(brief(str(path)), error) from error
    except ValueError as error:  # of a name with NUL or half a character
        raise _no_name(path) from error
    if other and Path(path).is_dir():
        raise StyleSplatError(f"Cannot read {path}: it is a folder. Give a file in it.")
    if other:
        raise StyleSplatError(f"Cannot read {path}: it is no plain file. Check the name.")


def read_bytes(path: Path | str, *, most: int | None = None, first: int = -1) -> bytes:
    """Read a plain file; pipes and devices may have no end.

    Args:
        path: The file.
        most: Bytes that such a file can have; None sets no bound.
        first: How many bytes are wanted; -1 is all.

    Raises:
        StyleSplatError: If there is none, or it is larger or cannot be read.
    """
    path = Path(path)
    with reading(path) as file:
        size = os.fstat(file.fileno()).st_size
        if most is not None and size > most:
            raise StyleSplatError(
                f"Cannot read {path}: it has {size} bytes, such files have {most} at most. "
                "Check the name."
            )
        return file.read(first)


@contextmanager
def reading(path: Path | str) -> Iterator[BinaryIO]:
    """A plain file to read from, bit by bit.

    Raises:
        StyleSplatError: If there is none, it cannot be read, or memory does not hold what it has.
    """
    path = Path(path)
    require_regular(path)
    try:
        file = path.open("rb")
    except ValueError as error:
        raise _no_name(path) from error
    except OSError as error:
        raise cannot_read(path, error) from error
    with file:
        try:
            yield file
        except OSError as error:
            raise cannot_read(path, error) from error
        except MemoryError as error:
            raise StyleSplatError(
                f"Cannot read {path}: it is larger than the free memory. Close other programs."
            ) from error


def file_stem(name: str) -> str:
    """A file name, without extension, for any text; it differs for any two, also if case is lost.

    Example:
        >>> file_stem("vase_2"), file_stem("Vase/Lid")
        ('vase_2', 'vase-lid~ef30192c6487ab44')
    """
    if PLAIN.fullmatch(name):
        return name
    readable = re.sub("[^a-z0-9_-]+", "-", name.lower()).strip("-")[:MAX_STEM]
    return f"{readable}~{hashlib.sha256(name.encode()).hexdigest()[:16]}"


def is_there(path: Path | str) -> bool:
    """Whether anything has a name; unlike Path's own question, it takes any."""
    return os.path.exists(path)  # noqa: PTH110


def is_file(path: Path | str) -> bool:
    """Whether a plain file has a name, whatever the name."""
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: Path | str) -> bool:
    """Whether a folder has a name, whatever the name."""
    return os.path.isdir(path)  # noqa: PTH112


def real_path(path: Path) -> Path:
    """Where links lead in the end; unlike Path.resolve, it takes those that lead in a circle."""
    return Path(os.path.realpath(path))


def real_place(path: Path) -> Path:
    """The same of a place to write to.

    Raises:
        StyleSplatError: If links lead in a circle.
    """
    real = real_path(path)
    if os.path.islink(real):  # noqa: PTH114 - unlike Path's, it takes any name
        raise StyleSplatError(f"{path} is a link that leads in a circle. Choose another name.")
    return real


def reason(error: Exception) -> str:
    """What an exception says, in one line: its first, or its name if it says nothing."""
    return str(error).partition("\n")[0] or type(error).__name__


def sync_folder(path: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system can do that."""
    with suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _sync_file(path: Path) -> None:
    """Wait until a file is on the disk, which may show only now that it is full."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def mark() -> str:
    """What makes a hidden name one that nothing has."""
    return uuid4().hex[:12]


def beside(path: Path) -> Path:
    """A hidden name in the same folder that nothing has."""
    return path.with_name(f".{path.stem}.{mark()}{path.suffix}")


def left_beside(path: Path) -> list[Path]:
    """What has one of the names that `beside` gives for a path: left by killed processes."""
    ours = re.compile(rf"\.{re.escape(path.stem)}\.{MARK}{re.escape(path.suffix)}")
    return [p for p in path.parent.glob(".*") if ours.fullmatch(p.name)]


def cannot_write(path: Path, error: OSError) -> StyleSplatError:
    """What to tell the user about a place that could not be written to."""
    if error.errno in DISK_FULL:
        return StyleSplatError(f"Cannot write {path}: disk full. Free some space and try again.")
    remedy = REMEDIES.get(error.errno or 0, ELSEWHERE) if error.strerror else ""
    return StyleSplatError(f"Cannot write {path}: {error.strerror or error}.{remedy}")


def _no_name(path: Path | str) -> StyleSplatError:
    return StyleSplatError(f"Cannot read {str(path)!r}: it is no name of a file. Check the name.")


def cannot_read(path: Path | str, error: OSError) -> StyleSplatError:
    """What to tell the user about a file that could not be read."""
    remedy = {
        errno.ENOENT: "Check the name.",
        errno.ENAMETOOLONG: "Check the name.",
        errno.EACCES: "Let its owner allow it to this user.",
    }.get(error.errno or 0, "Copy it to another place.")
    return StyleSplatError(f"Cannot read {path}: {error.strerror or error}. {remedy}")

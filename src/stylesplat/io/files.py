"""Plain files: reading them safely, what they are called, and what to say if that fails."""

import errno
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from stylesplat.errors import StyleSplatError, shorten

FILE_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
ANOTHER_PLACE = "Choose a place that this user may write to."
WRITE_REMEDIES = {
    errno.ENAMETOOLONG: "Choose a shorter name.",
    errno.EACCES: ANOTHER_PLACE,
    errno.EPERM: ANOTHER_PLACE,
    errno.EROFS: ANOTHER_PLACE,
}
READ_REMEDIES = {
    errno.ENOENT: "Check the name.",
    errno.ENAMETOOLONG: "Check the name.",
    errno.EACCES: "Let its owner allow it to this user.",
}
MAX_STEM = 48  # characters of a file name that are taken from a text
FILE_PLAIN = re.compile(f"[a-z0-9_-]{{1,{MAX_STEM}}}")


def read_bytes(path: Path | str, *, most: int | None = None, first: int = -1) -> bytes:
    """Read a plain file, or its `first` bytes; files of more than `most` bytes are refused."""
    with open_binary(path) as file:
        size = os.fstat(file.fileno()).st_size
        if most is not None and size > most:
            raise StyleSplatError(
                f"Cannot read {path}: it has {size} bytes, such files have {most} at most. "
                "Check the name."
            )
        return file.read(first)


@contextmanager
def open_binary(path: Path | str) -> Iterator[BinaryIO]:
    """Open a plain file; errors of the system within the block become StyleSplatErrors."""
    require_regular(path)
    try:
        with Path(path).open("rb") as file:
            yield file
    except OSError as error:
        raise cannot_read(path, error) from error
    except MemoryError as error:
        raise StyleSplatError(
            f"Cannot read {path}: it is larger than the free memory. Close other programs."
        ) from error


@contextmanager
def reading(path: Path | str, remedy: str, *, what: str = "") -> Iterator[None]:
    """Name the file, perhaps `what` it should be, and a remedy in any error of damaged content."""
    try:
        yield
    except (StyleSplatError, AssertionError):
        raise
    except Exception as error:
        raise StyleSplatError(f"Cannot read {path}{what}: {reason(error)}. {remedy}") from error


def require_regular(path: Path | str) -> None:
    """Raise a StyleSplatError for anything that exists but is no plain file: pipes may never end.

    A path where nothing is passes; a name that no file can have does not.
    """
    try:
        mode = os.stat(path).st_mode  # noqa: PTH116 - it also refuses names that no file can have
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise cannot_read(shorten(str(path)), error) from error
    except ValueError as error:  # a NUL, or half a surrogate pair
        raise StyleSplatError(
            f"Cannot read {str(path)!r}: this cannot be the name of a file. Check the name."
        ) from error
    if stat.S_ISDIR(mode):
        raise StyleSplatError(f"Cannot read {path}: it is a folder. Give a file in it.")
    if not stat.S_ISREG(mode):
        raise StyleSplatError(f"Cannot read {path}: it is no plain file. Check the name.")


def resolve_within(folder: Path, name: str) -> Path:
    """The path of a name that a file contains; a StyleSplatError if it leaves the folder."""
    path = folder / name
    here, there = folder.resolve(), path.parent.resolve()
    if path.name in ("", "..") or not there.is_relative_to(here):
        raise StyleSplatError(
            f"{shorten(name)!r} leads out of the folder {folder}. Rename it, or remove the link."
        )
    return path


def file_stem(name: str) -> str:
    """A file name without extension for any text; two texts differ even where case is ignored.

    Example:
        >>> file_stem("vase_2"), file_stem("Vase/Lid")
        ('vase_2', 'vase-lid~ef30192c6487ab44')
    """
    if FILE_PLAIN.fullmatch(name):
        return name
    readable = re.sub("[^a-z0-9_-]+", "-", name.lower()).strip("-")[:MAX_STEM]
    return f"{readable}~{hashlib.sha256(name.encode()).hexdigest()[:16]}"


def is_there(path: Path | str) -> bool:
    """Whether anything has this name. Unlike `Path.exists`, it takes any name."""
    return os.path.exists(path)  # noqa: PTH110


def is_file(path: Path | str) -> bool:
    """Whether a plain file has this name, whatever the name."""
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: Path | str) -> bool:
    """Whether a folder has this name, whatever the name."""
    return os.path.isdir(path)  # noqa: PTH112


def real_path(path: Path) -> Path:
    """The path without links. Unlike `Path.resolve`, it takes links that lead in a circle."""
    return Path(os.path.realpath(path))


def real_place(path: Path) -> Path:
    """The path without links of a place to write to; links in a circle are a StyleSplatError."""
    real = real_path(path)
    if os.path.islink(real):  # noqa: PTH114 - unlike Path's, it takes any name
        raise StyleSplatError(f"{path} is a link that leads in a circle. Choose another name.")
    return real


def reason(error: Exception) -> str:
    """The first line of an exception's message that says something, or its class."""
    if isinstance(error, KeyError):  # whose message is the key alone
        return f"it has no {shorten(str(error))}"
    lines = (line.strip() for line in str(error).splitlines())
    return next(filter(None, lines), type(error).__name__)


def cannot_write(path: Path, error: OSError) -> StyleSplatError:
    if error.errno in FILE_DISK_FULL:
        return StyleSplatError(f"Cannot write {path}: disk full. Free some space and try again.")
    remedy = WRITE_REMEDIES.get(error.errno or 0, "Choose another place.")
    return StyleSplatError(f"Cannot write {path}: {error.strerror or error}. {remedy}")


def cannot_read(path: Path | str, error: OSError) -> StyleSplatError:
    remedy = READ_REMEDIES.get(error.errno or 0, "Copy it to another place.")
    return StyleSplatError(f"Cannot read {path}: {error.strerror or error}. {remedy}")

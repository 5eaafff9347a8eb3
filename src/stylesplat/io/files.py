"""Files are written whole or not at all: to a temporary name beside the target, then renamed."""

import ctypes
import errno
import hashlib
import json
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

from stylesplat.errors import StyleSplatError

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux's <fcntl.h>: paths as they are; swap two
RENAME_SWAP = 2  # the same of macOS
MAX_STEM = 48  # characters of a file name that are taken from a text
PLAIN = re.compile(f"[a-z0-9_-]{{1,{MAX_STEM}}}")


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """A path to write to, which becomes `path` if the block succeeds and vanishes if not.

    The temporary file lies in the same folder and keeps the suffix; folders are made as needed.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    path = Path(path)
    temporary = _beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def claim_directory(path: Path | str, *, overwrite: bool, marker: str) -> Iterator[Path]:
    """An empty folder to fill, which becomes `path` if the block succeeds and vanishes if not.

    With `overwrite`, a folder of our own is replaced as a whole; in a folder that holds
    something else only the files of the same names are, so nothing of the user's is lost.

    Args:
        path: The folder to make.
        overwrite: Whether it may hold something already.
        marker: The file that tells a folder of our own.

    Raises:
        StyleSplatError: If `path` is a file or holds something and `overwrite` is off, or if
            the disk is full or the place cannot be written to.
    """
    path = Path(path).resolve()
    refuse_occupied(path, marker=marker, overwrite=overwrite)
    temporary = _beside(path)
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if not path.exists() or not any(path.iterdir()) or (path / marker).is_file():
            _swap(temporary, path)
        else:
            _merge(temporary, path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def revised_directory(path: Path | str) -> Iterator[Path]:
    """A copy of a folder to change, which takes its place if the block succeeds, else vanishes.

    Files are linked, not copied, so replace them (as `atomic_path` does) and never write into one.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    path = Path(path).resolve()
    try:
        with _place_for(path) as temporary:
            try:
                shutil.copytree(path, temporary, copy_function=_link)
                yield temporary
                _swap(temporary, path)
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise _cannot_write(path, error) from error


@contextmanager
def _place_for(path: Path) -> Iterator[Path]:
    """Where another version of a folder can be made: beside it, or else far away."""
    if _has_room_beside(path):
        yield _beside(path)
    else:
        with TemporaryDirectory() as elsewhere:
            yield Path(elsewhere) / path.name


def _has_room_beside(path: Path) -> bool:
    """Whether another folder can take the place of one: not of a volume of its own."""
    same_volume = path.stat().st_dev == path.parent.stat().st_dev
    return same_volume and os.access(path.parent, os.W_OK | os.X_OK)


def refuse_occupied(path: Path | str, *, marker: str, overwrite: bool = False) -> None:
    """Check that a folder can be claimed, before the work that will fill it.

    Args:
        path: The folder; it need not exist.
        marker: The file that tells a folder of our own.
        overwrite: Whether it may hold something.

    Raises:
        StyleSplatError: If `path` or a part of it is a file, it cannot be made or written to, or
            it holds anything and may not.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise StyleSplatError(f"{path} is a file. Choose another name for the folder.")
    _refuse_unwritable(path)
    if path.exists() and not overwrite and any(path.iterdir()):
        found = f"an earlier result ({marker})" if (path / marker).is_file() else "something else"
        raise StyleSplatError(
            f"The folder {path} holds {found}. "
            "Choose another one, or replace it with `--overwrite`."
        )


def _refuse_unwritable(path: Path) -> None:
    """Raise a StyleSplatError if nothing can be made beside a path."""
    there = next(parent for parent in path.absolute().parents if parent.exists())
    if not there.is_dir():
        raise StyleSplatError(f"Cannot make {path}: {there} is a file. Choose another folder.")
    if not os.access(there, os.W_OK | os.X_OK):
        raise StyleSplatError(f"Cannot make {path}: {there} may not be written to by this user.")


def read_json(path: Path | str) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    Raises:
        StyleSplatError: If the file is missing, unreadable or holds anything else.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise StyleSplatError(f"Cannot read {path}: {error.strerror}.") from error
    except ValueError as error:
        raise StyleSplatError(f"Cannot read {path}: it is not valid JSON ({error}).") from error
    if not isinstance(content, dict):
        raise StyleSplatError(f"Cannot read {path}: expected a JSON object.")
    return content


def write_json(content: Mapping[str, Any], path: Path | str) -> None:
    """Write a JSON file; see `strict_json`.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    text = strict_json(content, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def strict_json(content: Any, *, indent: int | None = None) -> str:
    """JSON as its standard has it: paths become strings, infinities and NaN, which it lacks, null.

    Example:
        >>> strict_json({"psnr": float("inf"), "file": Path("a.ply")})
        '{"psnr": null, "file": "a.ply"}'
    """
    return json.dumps(_strict(content), indent=indent, allow_nan=False, default=os.fspath)


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


def reason(error: Exception) -> str:
    """What an exception says, in one line: its first, or its name if it says nothing."""
    return str(error).partition("\n")[0] or type(error).__name__


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.stem}.{uuid4().hex[:12]}{path.suffix}")


def _cannot_write(path: Path, error: OSError) -> StyleSplatError:
    if error.errno in DISK_FULL:
        return StyleSplatError(f"Cannot write {path}: disk full. Free some space and try again.")
    return StyleSplatError(f"Cannot write {path}: {error.strerror or error}.")


def _link(source: str | Path, target: str | Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # not on every file system
        shutil.copy2(source, target)


def _swap(new: Path, path: Path) -> None:
    """Give a folder the place of another, which is left in its own, or gone."""
    if not path.exists():
        new.rename(path)
    elif new.parent != path.parent or Path.cwd().is_relative_to(path):
        _refill(path, new)  # else whoever stands in it, such as a shell, would be left nowhere
    elif not _exchanged(new, path):
        old = _beside(path)
        path.rename(old)
        try:
            new.rename(path)
        except BaseException:
            old.rename(path)
            raise
        shutil.rmtree(old, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Swap two folders in one step; False where the system cannot."""
    try:
        system = ctypes.CDLL(None)
    except (OSError, TypeError):  # Windows
        return False
    paths = os.fsencode(one), os.fsencode(other)
    if hasattr(system, "renameat2"):  # Linux
        return system.renameat2(AT_FDCWD, paths[0], AT_FDCWD, paths[1], RENAME_EXCHANGE) == 0
    return hasattr(system, "renamex_np") and system.renamex_np(*paths, RENAME_SWAP) == 0  # macOS


def _refill(path: Path, new: Path) -> None:
    """Give a folder the files of another, one by one; on failure its own again."""
    old = _beside(new)
    try:
        shutil.copytree(path, old, copy_function=_link)
        try:
            _mirror(new, path)
        except BaseException:
            _mirror(old, path)
            raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _mirror(source: Path, path: Path) -> None:
    """Make a folder hold what another does, and nothing else."""
    _merge(source, path)
    for file in sorted(path.rglob("*"), reverse=True):  # what is in a folder before the folder
        if not (source / file.relative_to(path)).exists():
            file.rmdir() if file.is_dir() else file.unlink()


def _merge(new: Path, path: Path) -> None:
    for source in sorted(p for p in new.rglob("*") if p.is_file()):
        target = path / source.relative_to(new)
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(target) as temporary:
            _link(source, temporary)


def _strict(value: Any) -> Any:
    if hasattr(value, "tolist"):  # of NumPy or torch
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_strict(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

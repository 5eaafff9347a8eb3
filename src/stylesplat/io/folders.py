"""Folders are filled whole or not at all: beside their place, then put there."""

import ctypes
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path, beside, cannot_write

AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux's <fcntl.h>: paths as they are; swap two
RENAME_SWAP = 2  # the same of macOS


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
    temporary = beside(path)
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if not path.exists() or not any(path.iterdir()) or (path / marker).is_file():
            _swap(temporary, path)
        else:
            _merge(temporary, path)
    except OSError as error:
        raise cannot_write(path, error) from error
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
        raise cannot_write(path, error) from error


@contextmanager
def _place_for(path: Path) -> Iterator[Path]:
    """Where another version of a folder can be made: beside it, or else far away."""
    if _has_room_beside(path):
        yield beside(path)
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
        old = beside(path)
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
    old = beside(new)
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

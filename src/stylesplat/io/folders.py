"""Folders are filled whole or not at all: beside their place, then put there."""

import ctypes
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import REPLACING, cannot_write, is_file, real_path, sync_folder
from stylesplat.io.journal import JOURNAL, draft_in, files_in, replace_files, sync_tree
from stylesplat.io.places import refuse_unwritable
from stylesplat.io.recovery import NEW, OLD, changing, hidden

AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux's <fcntl.h>: paths as they are; swap two
RENAME_SWAP = 2  # the same of macOS
PARTIAL = ".partial"  # what the folder of an interrupted run is called after that of its result


def partial_of(path: Path) -> Path:
    """Where what an interrupted run has done so far is kept: beside the result."""
    path = real_path(path)
    return path.with_name(path.name + PARTIAL)


@contextmanager
def claim_directory(
    path: Path | str, *, overwrite: bool, marker: str, stale: Sequence[str] = ()
) -> Iterator[Path]:
    """An empty folder to fill, which becomes `path` if the block succeeds and vanishes if not.

    With `overwrite`, a folder of our own is replaced as a whole; in a folder that holds
    something else only the files of the same names are, so nothing of the user's is lost.

    Args:
        path: The folder to make.
        overwrite: Whether it may hold something already.
        marker: The file that tells a folder of our own.
        stale: Files to take away from a folder that holds something else, known when the block
            ends.

    Raises:
        StyleSplatError: If `path` is a file or holds something and `overwrite` is off, or if
            the disk is full, the place cannot be written to, or another process changes it.
    """
    path = Path(path).resolve()
    with changing(path):
        refuse_occupied(path, marker=marker, overwrite=overwrite)
        with _place_for(path) as new:
            new.mkdir(parents=True)
            yield new
            whole = not path.exists() or not any(_entries(path)) or (path / marker).is_file()
            _put(new, path, whole=whole, stale=stale)


@contextmanager
def revised_directory(path: Path | str) -> Iterator[Path]:
    """A copy of a folder to change, which takes its place if the block succeeds, else vanishes.

    Files are linked, not copied, so replace them (as `atomic_path` does) and never write into one.
    The folder's earlier version is deleted, so no link is left.

    Raises:
        StyleSplatError: If the disk is full, the place cannot be written to, or another process
            changes it.
    """
    path = Path(path).resolve()
    with changing(path), _place_for(path) as new:
        ignore = shutil.ignore_patterns(JOURNAL + "*")
        shutil.copytree(path, new, symlinks=True, ignore=ignore, copy_function=_link)
        yield new
        _put(new, path, whole=True)


@contextmanager
def _place_for(path: Path) -> Iterator[Path]:
    """Where another version of a folder is made: beside it, or inside if the two cannot swap."""
    new = hidden(path, NEW) if _can_be_swapped(path) else draft_in(path)
    try:
        yield new
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        shutil.rmtree(new, ignore_errors=True)


def _can_be_swapped(path: Path) -> bool:
    """Whether another folder may take the place of one, in which nobody stands, such as a shell."""
    if not path.exists():
        return True
    return _has_room_beside(path) and not Path.cwd().is_relative_to(path)


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
    if is_file(path):
        raise StyleSplatError(f"{path} is a file. Choose another name for the folder.")
    refuse_unwritable(path)
    if path.exists() and not overwrite and any(_entries(path)):
        found = f"an earlier result ({marker})" if (path / marker).is_file() else "something else"
        raise StyleSplatError(
            f"The folder {path} holds {found}. Choose another one, or replace it with {REPLACING}."
        )


def _entries(path: Path) -> Iterator[Path]:
    """What is in a folder, but for what is about to replace it."""
    return (entry for entry in path.iterdir() if not entry.name.startswith(JOURNAL))


def _link(source: str | Path, target: str | Path) -> None:
    """Give a file another name, or copy it where it cannot have one."""
    try:
        os.link(source, target)
    except OSError:  # not on every file system
        shutil.copy2(source, target)


def _put(new: Path, path: Path, *, whole: bool, stale: Sequence[str] = ()) -> None:
    """Give a folder the place of another, or its files to it."""
    sync_tree(new)
    if not path.exists():
        new.rename(path)
    elif whole and new.parent == path.parent:
        _swap(new, path)
    elif whole:
        kept = {*files_in(new)}
        replace_files(path, new, [name for name in files_in(path) if name not in kept])
    else:
        replace_files(path, new, [Path(name) for name in stale if (path / name).exists()])
    sync_folder(path.parent)


def _swap(new: Path, path: Path) -> None:
    """Give a folder the place of another, which gets its name."""
    if _exchanged(new, path):
        return
    old = hidden(path, OLD)
    path.rename(old)
    try:
        new.rename(path)
    except BaseException:
        old.rename(path)
        raise
    try:
        old.rename(new)  # nobody shall put it back
    finally:
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

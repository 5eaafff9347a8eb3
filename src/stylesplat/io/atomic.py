"""Write files and folders whole or not at all: beside their place, then renamed into it.

One process at a time changes a place: `locked_folder` holds a lock on it. A killed process leaves
at most a hidden draft, which nobody reads.
"""

import ctypes
import errno
import hashlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import cannot_write, is_file, is_folder, is_there, real_path, real_place
from stylesplat.progress import say

if TYPE_CHECKING:
    from filelock import FileLock

REPLACING = "`--overwrite` (in Python overwrite=True)"  # how a user allows a replacement
PARTIAL = ".partial"  # suffix of the folder that keeps the work of an interrupted run
ATOMIC_DRAFT = ".stylesplat."  # begins the name of a draft inside the folder that it will replace
MAX_NAME_BYTES = 255  # of one part of a path, on all common file systems
# Seconds to wait for another process: `select` takes as long, `train` longer
ATOMIC_PATIENCE = 10.0
ANYBODY = 0o666  # mode of a lock file: another user may lock the same place later


def progress_path(path: Path) -> Path:
    """The folder beside a result that keeps the work of an interrupted run."""
    path = real_path(path)
    return path.with_name(path.name + PARTIAL)


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yields a path to write to; the file becomes `path` if the block succeeds, else it is deleted.

    The draft lies in the same folder and has the same suffix; missing folders are made. It is
    flushed to the disk before it is renamed, so a power cut leaves the old file or the new one.
    """
    path = Path(path)
    draft = _draft_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield draft
        with draft.open("rb+") as file:
            os.fsync(file.fileno())  # a full disk may show only now
        draft.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with suppress(OSError):
            draft.unlink()


def write_file(path: Path | str, content: bytes | str) -> None:
    """Write a file as a whole, or not at all; see `atomic_path`."""
    with atomic_path(path) as draft:
        if isinstance(content, str):
            draft.write_text(content, encoding="utf-8")
        else:
            draft.write_bytes(content)


@contextmanager
def atomic_folder(
    path: Path | str, *, overwrite: bool, marker: str, stale: Sequence[str] = ()
) -> Iterator[Path]:
    """Yields an empty folder, which becomes `path` if the block succeeds, else it is deleted.

    With `overwrite`, a folder that holds the file `marker` is replaced as a whole. In any other
    folder only files of the same names are replaced, and the files named in `stale` (read when the
    block ends) are deleted; everything else there stays.
    """
    path = Path(path).resolve()
    with locked_folder(path):
        refuse_occupied(path, marker=marker, overwrite=overwrite)
        with _draft_of(path) as draft:
            draft.mkdir(parents=True)
            yield draft
            if not path.exists() or not _has_entries(path) or (path / marker).is_file():
                _replace_folder(draft, path)
            else:
                _move_files(draft, path, [Path(n) for n in stale if (path / n).exists()])


@contextmanager
def revise_folder(path: Path | str) -> Iterator[Path]:
    """Yields a copy of a folder, which takes its place if the block succeeds, else it is deleted.

    The files of the copy are hard links, so replace them (as `atomic_path` does) and never write
    into one. The earlier version is deleted, so no link remains.
    """
    path = Path(path).resolve()
    with locked_folder(path), _draft_of(path) as draft:
        ignore = shutil.ignore_patterns(ATOMIC_DRAFT + "*")
        shutil.copytree(path, draft, symlinks=True, ignore=ignore, copy_function=_link)
        yield draft
        _replace_folder(draft, path)


@contextmanager
def locked_folder(path: Path | str) -> Iterator[None]:
    """Let no other process change a file or folder during the block; calls may be nested.

    The kernel holds the lock, so it ends with its process. The lock file lies beside the path, or
    in the temporary directory where that folder is not writable; it is deleted with the lock.
    """
    path = real_place(Path(path))
    try:
        path.exists()
    except OSError as error:  # the name is too long, or a folder may not be entered
        raise cannot_write(path, error) from error
    made = [parent for parent in path.parents if not parent.exists()]
    with suppress(OSError):  # the writer reports an unusable place
        path.parent.mkdir(parents=True, exist_ok=True)
    lock = _acquire(path)
    try:
        yield
    finally:
        if lock is not None:
            if lock.lock_counter == 1:
                with suppress(OSError):
                    Path(lock.lock_file).unlink()  # before the release: a waiting process notices
            lock.release()
        for parent in made:
            with suppress(OSError):  # it is used by now
                parent.rmdir()


def _acquire(path: Path) -> "FileLock | None":
    """The held lock of a path; None, after a warning, on a file system without locks."""
    from filelock import FileLock, Timeout  # loads asyncio, which few commands need

    if os.access(path.parent, os.W_OK | os.X_OK):
        file = path.with_name(f".{path.name}.lock")
    else:
        digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:16]
        file = Path(tempfile.gettempdir()) / f"stylesplat-{digest}.lock"
    lock = FileLock(file, is_singleton=True, fallback_to_soft=False, mode=ANYBODY)
    try:
        try:
            lock.acquire(blocking=False)
        except Timeout:
            _refuse_without_lock(path, file)
            say(f"Waiting for another stylesplat that changes {path}.")
            lock.acquire(timeout=ATOMIC_PATIENCE)
    except Timeout as error:
        raise StyleSplatError(
            f"Cannot change {path}: another stylesplat is at work on it. "
            "Wait until it is done, or end it."
        ) from error
    except (OSError, NotImplementedError) as error:
        # The writer reports a name that is too long, or a folder that cannot be made
        if getattr(error, "errno", None) not in (errno.ENAMETOOLONG, errno.ENOENT):
            _warn_unlocked(path.parent)
        return None
    return lock


def _refuse_without_lock(path: Path, file: Path) -> None:
    """Raise a StyleSplatError if no lock can be made: to `filelock` that looks like a held one."""
    try:
        with tempfile.TemporaryFile(dir=file.parent):
            pass
    except OSError as error:
        raise cannot_write(path, error) from error


@cache
def _warn_unlocked(folder: Path) -> None:
    say(f"{folder} is on a file system without locks. Change it from one process at a time.")


def refuse_occupied(path: Path | str, *, marker: str, overwrite: bool = False) -> None:
    """Raise a StyleSplatError unless `atomic_folder` can make this folder; ask before the work."""
    path = Path(path)
    if is_file(path):
        raise StyleSplatError(f"{path} is a file. Choose another name for the folder.")
    refuse_unwritable(path)
    if path.exists() and not overwrite and _has_entries(path):
        found = f"an earlier result ({marker})" if (path / marker).is_file() else "something else"
        raise StyleSplatError(
            f"The folder {path} holds {found}. Choose another one, or replace it with {REPLACING}."
        )


def refuse_file(path: Path | str, *, overwrite: bool = False) -> None:
    """Raise a StyleSplatError unless a file can be made here; ask before the work."""
    path = Path(path)
    if is_folder(path):
        raise StyleSplatError(f"{path} is a folder. Choose another name for the file.")
    if is_there(path) and not overwrite:
        raise StyleSplatError(
            f"{path} exists. Choose another name, or replace it with {REPLACING}."
        )
    _refuse_place(real_place(path))


def refuse_unwritable(path: Path | str) -> None:
    """Raise a StyleSplatError unless a folder can be made here, or the one here be changed."""
    path = real_place(Path(path))
    if not (is_folder(path) and os.access(path, os.W_OK | os.X_OK)):
        _refuse_place(path)


def _refuse_place(path: Path) -> None:
    """Raise a StyleSplatError if names are too long, or the nearest folder cannot be written to."""
    there = next(parent for parent in path.parents if os.path.lexists(parent))
    if not there.is_dir():
        raise StyleSplatError(f"Cannot make {path}: {there} is a file. Choose another folder.")
    parts = (*path.parts[:-1], _draft_name(path).name)
    if any(len(os.fsencode(part)) > MAX_NAME_BYTES for part in parts):
        raise cannot_write(path, OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG)))
    if not os.access(there, os.W_OK | os.X_OK):
        raise cannot_write(path, OSError(errno.EACCES, os.strerror(errno.EACCES)))


def _draft_name(path: Path) -> Path:
    """A new hidden name in the folder of a path, with the same suffix."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(6)}{path.suffix}")


def _has_entries(path: Path) -> bool:
    return any(not entry.name.startswith(ATOMIC_DRAFT) for entry in path.iterdir())


@contextmanager
def _draft_of(path: Path) -> Iterator[Path]:
    """Where the new version of a folder is made: beside it, or inside if the two cannot swap.

    They cannot if the folder is a volume of its own, or if this process was started in it: a shell
    would be left in a deleted folder.
    """
    swaps = not path.exists() or (
        path.stat().st_dev == path.parent.stat().st_dev
        and os.access(path.parent, os.W_OK | os.X_OK)
        and not Path.cwd().is_relative_to(path)
    )
    draft = _draft_name(path) if swaps else path / f"{ATOMIC_DRAFT}{secrets.token_hex(6)}"
    try:
        yield draft
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _replace_folder(draft: Path, path: Path) -> None:
    """Give a draft the place of a folder; the draft is then the earlier version, or gone."""
    if not path.exists():
        draft.rename(path)
    elif draft.parent == path:
        kept = {*_files_in(draft)}
        _move_files(draft, path, [name for name in _files_in(path) if name not in kept])
    elif not _exchange(draft, path):
        old = _draft_name(path)
        path.rename(old)
        try:
            draft.rename(path)
        except BaseException:
            old.rename(path)
            raise
        shutil.rmtree(old, ignore_errors=True)


def _move_files(draft: Path, path: Path, gone: Sequence[Path]) -> None:
    """Move the files of a draft into a folder and delete some there, once nothing is in the way."""
    for name in (*_files_in(draft), *gone):
        target = path / name
        there = next(parent for parent in target.parents if os.path.lexists(parent))
        taken = target if target.is_dir() and not target.is_symlink() else there
        if taken == target or not there.is_dir() or not there.resolve().is_relative_to(path):
            raise StyleSplatError(
                f"Cannot write {target}: {taken} is in the way. Move it elsewhere."
            )
    for name in _files_in(draft):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (draft / name).replace(path / name)
    for name in gone:
        (path / name).unlink()
        with suppress(OSError):  # not empty
            (path / name).parent.rmdir()


def _files_in(folder: Path) -> list[Path]:
    """All files and links in a folder and below, relative to it, in order; drafts aside."""
    found = (p for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())
    names = sorted(p.relative_to(folder) for p in found)
    return [name for name in names if not name.parts[0].startswith(ATOMIC_DRAFT)]


def _link(source: str | Path, target: str | Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # the file system has no hard links
        shutil.copy2(source, target)


def _exchange(one: Path, other: Path) -> bool:
    """Swap the names of two folders in one step; False where the system cannot."""
    try:
        system = ctypes.CDLL(None)
    except (OSError, TypeError):  # Windows
        return False
    paths = os.fsencode(one), os.fsencode(other)
    if hasattr(system, "renameat2"):  # Linux; -100: relative to the current folder; 2: exchange
        return system.renameat2(-100, paths[0], -100, paths[1], 2) == 0
    return hasattr(system, "renamex_np") and system.renamex_np(*paths, 2) == 0  # macOS; 2: swap

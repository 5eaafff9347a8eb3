"""One process at a time changes a scene, or whatever else a verb makes."""

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import ENAMETOOLONG, ENOENT
from functools import cache
from pathlib import Path

from filelock import FileLock, Timeout

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.progress import say

PATIENCE = 10.0  # seconds to wait for another process: `select` takes as long, `train` longer
NO_PLACE = (ENAMETOOLONG, ENOENT)  # whoever writes there says what is wrong with it
ANYBODY = 0o666  # another user may have to take over what a killed process left


@contextmanager
def locked(path: Path | str) -> Iterator[bool]:
    """Let no other process change a folder or a file meanwhile; within one, locks may be nested.

    The lock is the kernel's, so that of a killed process is none. It is kept on a file beside the
    folder, or in the temporary directory where none can be made there; it goes with the lock.

    Args:
        path: What will be changed; it need not exist.

    Yields:
        Whether it is locked: not every file system has locks.

    Raises:
        StyleSplatError: If another process has it locked, and for longer than we wait.
    """
    path = Path(path).resolve()
    made = [parent for parent in path.parents if not parent.exists()]
    with suppress(OSError):  # whoever writes there says what is wrong with the place
        path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(_lock_file(path), is_singleton=True, fallback_to_soft=False, mode=ANYBODY)
    try:
        if not _acquired(lock, path):
            yield False
            return
        try:
            yield True
        finally:
            _release(lock)
    finally:
        for parent in made:
            with suppress(OSError):  # not empty: used by now
                parent.rmdir()


def _lock_file(path: Path) -> Path:
    if os.access(path.parent, os.W_OK | os.X_OK):
        return path.with_name(f".{path.name}.lock")
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"stylesplat-{digest}.lock"


def _acquired(lock: FileLock, path: Path) -> bool:
    """Whether we have the lock; False where the file system has none, which is said."""
    try:
        try:
            lock.acquire(blocking=False)
        except Timeout:
            _try_place(Path(lock.lock_file))
            say(f"Waiting for another stylesplat{_holder(lock)} that changes {path}.")
            lock.acquire(timeout=PATIENCE)
    except Timeout as error:
        raise StyleSplatError(
            f"Cannot change {path}: another stylesplat{_holder(lock)} is at work on it. "
            "Wait until it is done, or end it."
        ) from error
    except (OSError, NotImplementedError) as error:
        if getattr(error, "errno", None) not in NO_PLACE:
            _say_unlocked(path.parent, reason(error))
        return False
    with suppress(OSError):  # it is for the messages above only
        Path(lock.lock_file).write_text(str(os.getpid()))
    return True


def _try_place(file: Path) -> None:
    """Raise an OSError where no file can be made, which filelock takes for another's lock."""
    if not file.exists():
        with tempfile.TemporaryFile(dir=file.parent):
            pass


def _release(lock: FileLock) -> None:
    """Give a lock back; the file goes before, which whoever waits for it notices."""
    if lock.lock_counter == 1:
        with suppress(OSError):
            Path(lock.lock_file).unlink()
    lock.release()


def _holder(lock: FileLock) -> str:
    try:
        process = Path(lock.lock_file).read_text()
    except (OSError, ValueError):
        return ""
    return f" (process {process})" if process.isdecimal() else ""


@cache
def _say_unlocked(folder: Path, why: str) -> None:
    """Once is enough."""
    say(f"Cannot lock anything in {folder} ({why}): change it from one process at a time only.")

"""What a killed process left half changed is made whole by the next one that comes there."""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import MARK, cannot_write, left_beside, mark, real_path, real_place
from stylesplat.io.journal import JOURNAL, finish
from stylesplat.io.locks import locked
from stylesplat.progress import say

T = TypeVar("T")

NEW = ".new"  # ends the name of a folder that is not, or no longer, worth anything
OLD = ".old"  # ends that of one that was moved away, and whose place is empty meanwhile
TEMPORARY = re.compile(rf"\.(?P<stem>.+)\.{MARK}(?P<suffix>\.[^.]+)?")
ATTEMPTS = 5  # at reading what others change; each takes seconds, and so does a change


def hidden(path: Path, kind: str) -> Path:
    """A name beside a folder that nothing has, and that tells what it is: `NEW` or `OLD`."""
    return path.with_name(f".{path.name}.{mark()}{kind}")


@contextmanager
def changing(path: Path | str) -> Iterator[None]:
    """Keep others from changing a folder or a file, after making whole what a killed one left.

    Raises:
        StyleSplatError: If another process changes it, for longer than we wait, or what is half
            done cannot be finished.
    """
    path = real_place(Path(path))
    try:
        path.exists()
    except OSError as error:  # of a name that is too long, or a folder that may not be entered
        raise cannot_write(path, error) from error
    with locked(path) as alone:
        _recover(path)
        if alone:  # else another process may be at work on a draft
            _remove_leftovers(path)
        yield


def settled(path: Path | str, read: Callable[[Path], T]) -> T:
    """What reading a folder gives, from one state of it, though others may change it meanwhile.

    Args:
        path: The folder.
        read: Reads it.

    Raises:
        StyleSplatError: If `read` does, or the folder is half changed and this user may not
            finish that, or it does not come to rest.
    """
    path = Path(path)
    for _ in range(ATTEMPTS):
        ensure_whole(path)
        before = _state(path)
        try:
            found = read(path)
        except StyleSplatError:
            if _state(path) == before and not _half_changed(path):
                raise
        else:
            if _state(path) == before:
                return found
    raise StyleSplatError(
        f"Cannot read {path}: it was changed all {ATTEMPTS} times. Try again when that is done."
    )


def ensure_whole(path: Path | str) -> None:
    """Finish what a killed process has begun to change in a folder, before it is read.

    Raises:
        StyleSplatError: If this user may not, or another process is still at it.
    """
    path = real_path(Path(path))
    if not _half_changed(path):
        return
    place = path if path.exists() else path.parent
    if not os.access(place, os.W_OK | os.X_OK):
        raise StyleSplatError(
            f"{path} is half changed: the process that changed it was ended, and this user may "
            "not finish that. Let somebody open it who may write to it."
        )
    with changing(path):
        pass


def _half_changed(path: Path) -> bool:
    return (path / JOURNAL).exists() or (not path.exists() and bool(_moved_away(path)))


def _moved_away(path: Path) -> list[Path]:
    """Folders that made room for others that never came."""
    return [p for p in _hidden_beside(path, OLD) if p.is_dir()]


def _recover(path: Path) -> None:
    try:
        if not path.exists() and (old := _moved_away(path)):
            max(old, key=lambda folder: folder.stat().st_mtime).rename(path)
            say(f"Put {path} back, which a process that was ended had moved away.")
        if (path / JOURNAL).exists():
            finish(path)
            say(f"Finished the change of {path} that a process which was ended had begun.")
    except OSError as error:
        raise cannot_write(path, error) from error


def _remove_leftovers(path: Path) -> None:
    removed = sum(map(_removed, _leftovers(path)))
    if removed:
        say(f"Removed {removed} unfinished files or folders of ended processes at {path}.")


def _leftovers(path: Path) -> list[Path]:
    """What killed processes left of changes to a folder or a file."""
    found = [*_hidden_beside(path, NEW), *_hidden_beside(path, OLD)]
    # Earlier versions called folders so as well, the old and the new
    found += [p for p in left_beside(path) if p.is_file() or path.exists()]
    if path.is_dir():
        found += [p for p in path.glob(f"{JOURNAL}.*") if re.fullmatch(MARK, p.suffix[1:])]
        found += [p for p in path.glob(".*") if _is_temporary(p) and p.is_file()]
    return found


def _hidden_beside(path: Path, kind: str) -> list[Path]:
    ours = re.compile(rf"\.{re.escape(path.name)}\.{MARK}{re.escape(kind)}")
    return [p for p in path.parent.glob(".*") if ours.fullmatch(p.name)]


def _is_temporary(file: Path) -> bool:
    """Whether a file is the unfinished form of one beside it."""
    match = TEMPORARY.fullmatch(file.name)
    return bool(match) and file.with_name(match["stem"] + (match["suffix"] or "")).is_file()


def _removed(path: Path) -> bool:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()
    return not os.path.lexists(path)


def _state(path: Path) -> tuple[int, ...] | None:
    """What differs after a change of a folder: another one, or other names in it."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns

"""Files of a folder are replaced one by one, yet all of them or none, whoever is killed meanwhile.

All that is to be done is put into the folder first, under a hidden name; the moment that it gets
the journal's, it is decided. Who finds a journal does what is left of it.
"""

import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import mark, sync_folder

JOURNAL = ".replacing"
FILES, GONE = "files", "gone"  # in it: what is to be moved, and an empty file for each to delete


def draft_in(path: Path) -> Path:
    """A hidden name in a folder that nothing has, for what is to replace something there."""
    return path / f"{JOURNAL}.{mark()}"


def replace_files(path: Path, new: Path, gone: Iterable[Path]) -> None:
    """Move the files of a folder into another one of the same volume, and delete some there.

    Args:
        path: The folder that is changed.
        new: The folder whose files are taken.
        gone: What to delete, relative to `path`.

    Raises:
        StyleSplatError: If a file would go elsewhere, through a link, or where a folder is.
        OSError: If the place cannot be written to; before anything is decided all stays as it was.
    """
    draft = draft_in(path)
    try:
        _drop_same(new, path)
        draft.mkdir()
        new.rename(draft / FILES)
        for name in gone:
            (draft / GONE / name).parent.mkdir(parents=True, exist_ok=True)
            (draft / GONE / name).touch()
        _refuse_unfit(path, [*files_in(draft / FILES), *files_in(draft / GONE)])
        sync_tree(draft)
        draft.rename(path / JOURNAL)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    sync_folder(path)
    try:
        finish(path)
    except BaseException:  # Ctrl-C among others: what is decided is done
        finish(path)
        raise


def finish(path: Path) -> None:
    """Do what is left of a journal.

    Raises:
        StyleSplatError: If it would change anything outside the folder, so is not of ours.
        OSError: If the place cannot be written to.
    """
    journal = path / JOURNAL
    new, gone = files_in(journal / FILES), files_in(journal / GONE)
    if any((journal / part).resolve() != journal / part for part in (FILES, GONE)):
        raise StyleSplatError(f"{journal} is a link or holds one, so it is not ours. Remove it.")
    _refuse_unfit(path, [*new, *gone])
    for name in new:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (journal / FILES / name).replace(path / name)
    for name in gone:
        (path / name).unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            (path / name).parent.rmdir()
    for folder in {(path / name).parent for name in (*new, *gone)}:
        sync_folder(folder)
    done = draft_in(path)
    journal.rename(done)
    shutil.rmtree(done, ignore_errors=True)


def files_in(folder: Path) -> list[Path]:
    """All files and links in a folder and below, relative to it, in order; journals aside."""
    found = (p for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())
    names = sorted(p.relative_to(folder) for p in found)
    return [name for name in names if not name.parts[0].startswith(JOURNAL)]


def sync_tree(folder: Path) -> None:
    """Wait until the names in a folder and below are on the disk; files are when written."""
    for path in (folder, *folder.rglob("*")):
        if path.is_dir() and not path.is_symlink():
            sync_folder(path)


def _drop_same(new: Path, path: Path) -> None:
    """Take away from a revised folder what is in the other one already."""
    for name in files_in(new):
        one, other = new / name, path / name
        if os.path.lexists(other) and _is_same(one, other):
            one.unlink()


def _is_same(one: Path, other: Path) -> bool:
    if one.is_symlink() or other.is_symlink():
        both = one.is_symlink() and other.is_symlink()
        return both and one.readlink() == other.readlink()
    return one.samefile(other)


def _refuse_unfit(path: Path, names: Iterable[Path]) -> None:
    """Raise a StyleSplatError unless all files can be put into, or deleted from, the folder."""
    root, volume = path.resolve(), path.stat().st_dev
    for name in names:
        target = path / name
        there = next(parent for parent in target.parents if os.path.lexists(parent))
        if not there.resolve().is_relative_to(root):
            raise StyleSplatError(
                f"Cannot write {target}: {there} leads outside {path}. Remove it."
            )
        if not there.is_dir() or (target.is_dir() and not target.is_symlink()):
            taken = target if there.is_dir() else there
            raise StyleSplatError(
                f"Cannot write {target}: {taken} is in the way. Move it elsewhere."
            )
        if there.stat().st_dev != volume:
            raise StyleSplatError(
                f"Cannot write {target}: {there} is a volume of its own. Choose another folder."
            )

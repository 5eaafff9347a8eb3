"""Whether what a verb makes can be written, asked before the work that makes it.

That there is room for all of it is not promised.
"""

import os
from contextlib import suppress
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import REPLACING, beside, cannot_write, is_folder, is_there, real_place
from stylesplat.io.journal import draft_in
from stylesplat.io.recovery import NEW, hidden


def refuse_unwritable(path: Path | str) -> None:
    """Make something in the place of a folder, or for one that is there in it, and remove it.

    Raises:
        StyleSplatError: If that fails, or a part of the path is a file.
    """
    path = real_place(Path(path))
    if not is_folder(path):
        _try(path, hidden(path, NEW))
        return
    try:
        _try(path, hidden(path, NEW))
    except StyleSplatError:  # nothing can be made beside it, as on a volume of its own
        _try(path, draft_in(path))


def refuse_file(path: Path | str, *, overwrite: bool = False) -> None:
    """Check that a file can be made, with the hidden name that it has until it is whole.

    Args:
        path: The file; it need not exist.
        overwrite: Whether it may.

    Raises:
        StyleSplatError: If a folder is there, or a file that may not be replaced, or nothing can
            be made there.
    """
    path = Path(path)
    if is_folder(path):
        raise StyleSplatError(f"{path} is a folder. Choose another name for the file.")
    if is_there(path) and not overwrite:
        raise StyleSplatError(
            f"{path} exists. Choose another name, or replace it with {REPLACING}."
        )
    path = real_place(path)
    _try(path, beside(path))


def _try(path: Path, trial: Path) -> None:
    """Make a folder for a moment, and those that it lies in."""
    there = next(parent for parent in path.parents if os.path.lexists(parent))
    if not there.is_dir():
        raise StyleSplatError(f"Cannot make {path}: {there} is a file. Choose another folder.")
    made = [parent for parent in path.parents if parent.is_relative_to(there) and parent != there]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        trial.mkdir()
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        for folder in (trial, *made):
            with suppress(OSError):
                folder.rmdir()

"""Paths of job files and their results: what lies on disks, or is mounted as if it did."""

import os
import re
from pathlib import Path

from stylesplat.errors import StyleSplatError, brief

ADDRESS = re.compile(r"[A-Za-z][\w+.-]+:/")  # a scheme is longer than the letter of a drive


def path_in(folder: Path, text: str) -> Path:
    """A path of a job file as one that holds everywhere.

    Args:
        folder: That of the file, which paths are relative to.
        text: What it says.

    Raises:
        StyleSplatError: If it is an address.
    """
    refuse_address(text)
    return Path(os.path.abspath(folder / text))  # noqa: PTH100 - links stay


def refuse_address(text: str | Path) -> None:
    """Raise a StyleSplatError for what is reached by an address, such as `s3://bucket/scene`."""
    if ADDRESS.match(str(text)):
        raise StyleSplatError(
            f"{brief(str(text))!r} is an address, and jobs read and write files. Mount it (docs/"
            "batch.md says how), or copy it to a disk."
        )

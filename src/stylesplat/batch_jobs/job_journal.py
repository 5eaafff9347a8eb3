"""The journal of a batch: a line of JSON for each job that has ended, in `jobs.jsonl`."""

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import msgspec

from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import cannot_write, read_bytes
from stylesplat.io.json_files import strict_json
from stylesplat.progress import say

JOURNAL = "jobs.jsonl"
MAX_JOURNAL = 2**30  # bytes; a line has some 1,000
Status = Literal["done", "failed", "skipped"]


class JobLine(msgspec.Struct, frozen=True, kw_only=True):
    """How a job ended."""

    job: str
    """Its name, and that of its folder."""
    status: Status
    fingerprint: str
    """Of what it was made of; see `fingerprints`."""
    verb: str
    command: tuple[str, ...] = ()
    """What was run, to be pasted behind `stylesplat`."""
    seconds: float = 0.0
    threads: int = 0
    memory_gb: float | None = None
    """The most that it took at a time, where the system tells."""
    node: str = ""
    """Where it ran, if not here."""
    ended: str = ""
    """When, UTC."""
    reason: str = ""
    """Why it is not done, in a line."""
    result: dict[str, Any] = {}
    """What the verb printed with `--json`."""


class JobJournal:
    """The journal of a folder, kept open to be added to.

    A line is on the disk before the next job is told of; the torn last line of a process that was
    killed is dropped when it is read.
    """

    def __init__(self, folder: Path, kept: Iterable[JobLine]) -> None:
        """Begin it with lines of earlier runs.

        Raises:
            StyleSplatError: If the disk is full or the place cannot be written to.
        """
        self._path = folder / JOURNAL
        with atomic_path(self._path) as temporary:
            temporary.write_text("".join(map(_text, kept)), encoding="utf-8")

    def add(self, line: JobLine) -> None:
        """Write a line, and wait until it is on the disk.

        Raises:
            StyleSplatError: If the disk is full or the place cannot be written to.
        """
        try:
            with self._path.open("ab", buffering=0) as file:
                file.write(_text(line).encode())
                os.fsync(file.fileno())
        except OSError as error:
            raise cannot_write(self._path, error) from error


def read_journal(folder: Path) -> dict[str, JobLine]:
    """The last line of each job, by name; nothing where there is no journal.

    Raises:
        StyleSplatError: If it cannot be read.
    """
    path = folder / JOURNAL
    if not path.exists():
        return {}
    found: dict[str, JobLine] = {}
    unread = 0
    for text in read_bytes(path, most=MAX_JOURNAL).splitlines():
        line = None
        with suppress(msgspec.DecodeError, UnicodeDecodeError):
            line = msgspec.json.decode(text, type=JobLine)
        if line is None:
            unread += 1
        else:
            found[line.job] = line
    if unread:
        say(f"Lines of {path} that cannot be read: {unread}. Their jobs are run again.")
    return found


def still_valid(
    lines: Mapping[str, JobLine], prints: Mapping[str, str], folder: Path
) -> dict[str, JobLine]:
    """The lines of jobs that are done and need not be run again.

    Args:
        lines: Of earlier runs.
        prints: The fingerprints of the jobs to do.
        folder: Where their results are.
    """
    return {
        name: lines[name]
        for name, digest in prints.items()
        if name in lines
        and (lines[name].status, lines[name].fingerprint) == ("done", digest)
        and (folder / name).exists()
    }


def _text(line: JobLine) -> str:
    return strict_json(msgspec.to_builtins(line)) + "\n"

"""Calls of pycolmap that take long: with a bar, interruptible, and unable to take us with them."""

import json
import re
import subprocess
import sys
from collections import deque
from contextlib import suppress
from errno import ENOSPC
from pathlib import Path
from typing import Any

import stylesplat
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import cannot_write
from stylesplat.progress import Task, task

FATAL = 3  # the level of what COLMAP logs before the process ends
LINES_KEPT = 50  # of what a process says: its last words
FULL = re.compile("disk is full|disk I/O error|No space left|File too large|quota exceeded", re.I)
NOISE = re.compile(r"^(\s*@|\*\*\*|PC:|terminate called)")  # around what glog has to say
PLACE = re.compile(r"^(failed: |\s*what\(\):\s*|\[[\w.]+:\d+\] )+")


def run_stage(
    stage: str, settings: dict[str, Any], what: str, total: int, unit: str, done: int = 0
) -> None:
    """Run one of `colmap_stages` in a process that ends if this one ends or is interrupted.

    What the database held is not lost by that: SQLite keeps a log.

    Args:
        stage: The name of the stage.
        settings: What it goes by; its `database` lies where all is written.
        what: What is done, for the bar.
        total: How much there is to do.
        unit: What is counted.
        done: How much of it an earlier call did.

    Raises:
        StyleSplatError: If the disk is full, or COLMAP gives up.
    """
    place = str(Path(stylesplat.__file__).parents[1])
    code = f"import sys; sys.path.insert(0, {place!r}); from {__package__} import colmap_stages"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{code}; colmap_stages.main()", stage],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
    )
    last: deque[str] = deque(maxlen=LINES_KEPT)
    try:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # it ended at once, and says below why
            process.stdin.write(json.dumps(settings) + "\n")
            process.stdin.flush()
        with task(what, total, unit=unit, done=done) as bar:
            _follow(process, bar, total, done, last)
        status = process.wait()
    finally:
        process.kill()
        process.communicate()
    if status:
        raise _failure(what, Path(settings["database"]), [*last], status)


def _follow(
    process: "subprocess.Popen[str]", bar: Task, total: int, done: int, last: "deque[str]"
) -> None:
    """Advance the bar by the numbers that a process prints, and keep its other lines."""
    assert process.stdout is not None
    for line in process.stdout:
        if not line.strip().isdecimal():
            last.append(line.rstrip())
            continue
        now = min(int(line), total)  # several models may have the same photo
        if now > done:
            bar.advance(now - done)
            done = now


def is_full(text: str) -> bool:
    """Whether COLMAP or SQLite says that there is no room on the disk."""
    return bool(FULL.search(text))


def _failure(what: str, database: Path, lines: list[str], status: int) -> StyleSplatError:
    said = [PLACE.sub("", line) for line in lines if line.strip() and not NOISE.match(line)]
    if any(is_full(line) for line in lines):
        return cannot_write(database, OSError(ENOSPC, ""))
    words = said[0] if said else f"it ended with status {status}"
    return StyleSplatError(f"{what}: COLMAP gave up: {words}. Run the same command again.")

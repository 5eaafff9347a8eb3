"""Nothing lost, nothing let in: damaged files, kills, full disks, strangers, company.

    .venv/bin/python benchmarks/faults.py              # ten to twenty-five minutes on two cores
    .venv/bin/python benchmarks/faults.py --quick      # about two

Mutants of all formats are read in processes whose memory is bounded, as in `tests/faults`, only
more of them. Then real commands on a tiny scene are killed at random moments, run where the disk is
full (needs root), as a user without a home who may write nowhere else (needs root), and two at a
time. A command that is killed must leave what was there before or what it makes, and nothing
hidden once it has been run again. Exits with 1 if anything fails; each failure is printed with its
seed, and `--seed` and `--only` run it again.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / each) for each in ("src", "tests/faults", "tests")]

from bench import machine, table  # noqa: E402
from fault_commands import make_place  # noqa: E402
from fault_kills import kills  # noqa: E402
from fault_places import full_disk, together, unprivileged  # noqa: E402

import stylesplat  # noqa: F401, E402  (first: it sets up threading before torch loads)
from readers import READERS  # noqa: E402
from trials import GOOD, Trial, Worker, described  # noqa: E402

Part = Literal["mutants", "kills", "disk", "user", "two"]
COLUMNS = {  # of the table, with the outcomes that they count
    "refused": ("refused",),
    "fine": ("fine",),
    "tracebacks": ("traceback", "garbled", "exit"),
    "crashes": ("crash",),
    "over memory": ("memory",),
    "hangs": ("hang",),
    "lost": ("lost", "escaped"),
    "skipped": ("skipped",),
}


@dataclass(frozen=True)
class Options:
    """How much to try."""

    mutants: int = 10_000
    """Damaged files, over all readers."""
    kills: int = 100
    """Commands that are killed, over all verbs and three signals."""
    repeats: int = 2
    """Of each pair of commands at once."""
    jobs: int = 2
    """Processes at a time."""
    seed: int = 0
    """The first one."""
    quick: bool = False
    """A tenth of the mutants, a fifth of the kills, each pair once."""
    only: tuple[Part, ...] = ("mutants", "kills", "disk", "user", "two")
    """What to try."""


def mutants(folder: Path, options: Options) -> Iterator[Trial]:
    """All readers, each with a process of its own."""
    count = -(-options.mutants // len(READERS))

    def read(reader: str) -> list[Trial]:
        worker = Worker(folder / reader)
        try:
            return [*worker.trials(reader, options.seed, count)]
        finally:
            worker.close()

    with ThreadPoolExecutor(options.jobs) as pool:
        for trials in pool.map(read, READERS):
            yield from trials


def parts(folder: Path, options: Options) -> dict[Part, Callable[[], Iterator[Trial]]]:
    """What can be tried, by name."""
    place = make_place(folder / "place") if {*options.only} - {"mutants"} else folder
    return {
        "mutants": lambda: mutants(folder / "mutants", options),
        "kills": lambda: kills(place, folder / "kills", options.kills, options.seed, options.jobs),
        "disk": lambda: full_disk(place, folder / "disk"),
        "user": lambda: unprivileged(place, folder / "user"),
        "two": lambda: together(place, folder / "two", options.repeats),
    }


def row(kind: str, trials: list[Trial]) -> list[object]:
    """A line of the table."""
    counts = Counter(trial.outcome for trial in trials)
    tried = len(trials) - counts["skipped"]
    return [kind, tried, *(sum(counts[each] for each in kinds) for kinds in COLUMNS.values())]


def main(options: Options) -> None:
    """Try it all, and print the table."""
    if options.quick:
        tenth, fifth = options.mutants // 10, options.kills // 5
        options = Options(
            tenth, fifth, repeats=1, jobs=options.jobs, seed=options.seed, only=options.only
        )
    print(f"{machine()}, seeds from {options.seed}", flush=True)
    found: list[Trial] = []
    with tempfile.TemporaryDirectory() as name:
        for part, trials in parts(Path(name), options).items():
            begun = time.perf_counter()
            for trial in trials() if part in options.only else ():
                found.append(trial)
                if trial.outcome not in GOOD:
                    print(described(trial), flush=True)
            print(f"{part}: {time.perf_counter() - begun:.0f} s", flush=True)
    by_kind: dict[str, list[Trial]] = {}
    for trial in found:
        by_kind.setdefault(trial.reader, []).append(trial)
    rows = [row(kind, trials) for kind, trials in by_kind.items()]
    print(table(["kind", "tried", *COLUMNS], [*rows, row("all", found)]))
    sys.exit(any(trial.outcome not in (*GOOD, "skipped") for trial in found))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))

"""Whatever a file holds, its reader gives something usable or says in one line what is wrong.

A mutant that fails is printed with its seed and file: `mutants.mutant` makes it again.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from mutants import mutant
from readers import READERS
from trials import GOOD, Trial, Worker, described

MUTANTS = 60  # of each reader; `benchmarks/faults.py` tries thousands


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    worker = Worker(tmp_path_factory.mktemp("mutants"))
    yield worker
    worker.close()


def trials_of(worker: Worker, reader: str) -> list[Trial]:
    return [*worker.trials(reader, 0, MUTANTS)]


@pytest.mark.parametrize("reader", [*READERS])
def test_a_mutant_is_read_or_refused_in_one_line(worker: Worker, reader: str):
    trials = trials_of(worker, reader)
    failed = [described(trial) for trial in trials if trial.outcome not in GOOD]
    assert not failed, "\n".join(failed)
    assert len(trials) == MUTANTS
    assert any(trial.outcome == "refused" for trial in trials), "the mutants are too tame"


def test_a_seed_makes_the_same_mutant_again():
    content = b'{"a": [1, 2, {"b": "c"}], "d": null}'
    mutants = [mutant("a.json", content, seed) for seed in range(200)]
    assert mutants == [mutant("a.json", content, seed) for seed in range(200)]
    assert len({*mutants}) > 100


SCRIPT = """
import json, os, sys, time
for line in sys.stdin:
    _, first, count = json.loads(line)
    for seed in range(first, first + count):
        if seed == 1:
            os.abort()
        if seed == 2:
            time.sleep(100)
        print(json.dumps([seed, "file", "fine", "", 0.0]), flush=True)
"""


def test_crashes_and_hangs_are_told_and_the_next_mutant_follows(tmp_path: Path, monkeypatch):
    (tmp_path / "script.py").write_text(SCRIPT)
    monkeypatch.setattr("trials.STARTS", 6.0)
    worker = Worker(tmp_path / "work", script=tmp_path / "script.py", patience=4.0)
    outcomes = [trial.outcome for trial in worker.trials("any", 0, 4)]
    worker.close()
    assert outcomes == ["fine", "crash", "hang", "fine"]

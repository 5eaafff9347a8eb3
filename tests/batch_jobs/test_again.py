"""What is run again, in which order, and what is recorded."""

import os
from pathlib import Path

import pytest

from processes import planned, pretend
from stylesplat.batch_jobs.run_batch import RECORDS, fingerprints, read_records, run_in_order

TEXT = """
    scenes: [garden, desk]
    jobs:
      - stylize: {style: {vase: wave.jpg}, scale: 2}
        then:
          - export: {output: vase.ply}
"""


@pytest.mark.parametrize("what", ["nothing", "picture", "scene", "drawn", "setting", "object"])
def test_a_fingerprint_is_of_inputs_and_settings(what: str, tmp_path: Path):
    jobs = planned(tmp_path, TEXT)
    before = fingerprints([*jobs.values()])
    if what == "picture":
        (tmp_path / "wave.jpg").write_text("another")
    elif what == "scene":
        os.utime(tmp_path / "garden" / "splats.ply", (1, 1))
    elif what == "drawn":
        (tmp_path / "garden" / "objects.png").write_text("drawn later")
    elif what == "setting":
        jobs = planned(tmp_path, TEXT.replace("2}", "3}"))
    elif what == "object":
        jobs = planned(tmp_path, TEXT.replace("vase: w", "pot: w"))
    after = fingerprints([*jobs.values()])
    changed = {name for name in before if before[name] != after[name]}
    expected = {"nothing": [], "drawn": [], "scene": [n for n in jobs if n.startswith("garden")]}
    assert changed == {*expected.get(what, jobs)}


def test_a_torn_line_costs_its_job_only(tmp_path: Path):
    path = tmp_path / RECORDS
    line = '{"job": "%s", "verb": "render", "status": "%s"}\n'
    path.write_text(line % ("a", "done") + line % ("b", "done") + line % ("b", "failed"))
    with path.open("a") as file:
        file.write('{"job": "c", "sta')
    assert {n: r.status for n, r in read_records(path).items()} == {"a": "done", "b": "failed"}
    assert read_records(tmp_path / "nowhere") == {}


def run(folder: Path, slots: int, failing: str = "", done: str = "") -> tuple[list[str], dict]:
    jobs, begun = planned(folder, TEXT), list[str]()
    executor = pretend(slots, begun, lambda name: name == failing)
    records = run_in_order([j for n, j in jobs.items() if n != done], {done}, executor)
    return begun, {record.job: record.status for record in records}


def test_jobs_follow_the_ones_they_need(tmp_path: Path):
    begun, statuses = run(tmp_path, 1)
    assert {*statuses.values()} == {"done"}
    assert begun == [*planned(tmp_path, TEXT)], "a scene is finished before the next one begins"
    begun, _ = run(tmp_path, 2)
    assert begun[:2] == ["garden-stylize", "desk-stylize"], "two run, each as soon as it can"
    begun, _ = run(tmp_path, 1, done="garden-stylize")
    assert begun[0] == "garden-stylize-export"


def test_a_failure_costs_what_follows_it_only(tmp_path: Path):
    _, statuses = run(tmp_path, 2, failing="garden-stylize")
    assert statuses == {
        "garden-stylize": "failed",
        "garden-stylize-export": "skipped",
        "desk-stylize": "done",
        "desk-stylize-export": "done",
    }

"""What is run again, in which order, and what is written down."""

import os
from pathlib import Path

import pytest

from job_files import Pretended, planned
from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.batch_jobs.job_inputs import fingerprints
from stylesplat.batch_jobs.job_journal import (
    JOURNAL,
    JobJournal,
    JobLine,
    Status,
    read_journal,
    still_valid,
)
from stylesplat.batch_jobs.run_batch import scheduled

TEXT = """
    scenes: [garden, desk]
    jobs:
      - stylize: {style: {vase: wave.jpg}, scale: 2}
        then:
          - export: {output: vase.ply}
"""


def prints(folder: Path, text: str = TEXT) -> dict[str, str]:
    return fingerprints(tuple(planned(folder, text).values()))


def line(name: str, status: Status = "done", fingerprint: str = "x") -> JobLine:
    return JobLine(job=name, status=status, fingerprint=fingerprint, verb="render")


def run(todo: dict[str, Job], crew: Pretended, *done: str) -> list[tuple[str, object]]:
    ended = scheduled([*todo.values()], {*done}, crew, lambda: None)
    return [(job.name, o if isinstance(o, str) else o.status) for job, o in ended]


@pytest.mark.parametrize("what", ["picture", "scene", "setting", "object"])
def test_a_fingerprint_is_of_inputs_and_settings(what: str, tmp_path: Path):
    before = prints(tmp_path)
    assert prints(tmp_path) == before, "of the same files"
    text = TEXT
    if what == "picture":
        jobs = planned(tmp_path, TEXT)
        (tmp_path / "wave.jpg").write_text("another")
        after = fingerprints(tuple(jobs.values()))
    elif what == "scene":
        jobs = planned(tmp_path, TEXT)
        os.utime(tmp_path / "garden" / "splats.ply", (1, 1))
        (tmp_path / "garden" / "objects.png").write_text("drawn later")
        after = fingerprints(tuple(jobs.values()))
    else:
        text = TEXT.replace("2}", "3}") if what == "setting" else TEXT.replace("vase: w", "pot: w")
        after = prints(tmp_path, text)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {n for n in before if what != "scene" or n.startswith("garden")}


def test_a_picture_drawn_into_a_scene_changes_nothing(tmp_path: Path):
    jobs = tuple(planned(tmp_path, TEXT).values())
    before = fingerprints(jobs)
    (tmp_path / "garden" / "objects.png").write_text("drawn later")
    assert fingerprints(jobs) == before


def test_a_recipe_counts_with_its_pictures(tmp_path: Path):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("objects: {vase: {style: wave.jpg}}")
    text = "scenes: [garden]\njobs: [{stylize: {recipe: recipe.yaml}}]"
    jobs = tuple(planned(tmp_path, text).values())
    before = fingerprints(jobs)
    (tmp_path / "wave.jpg").write_text("another")
    assert fingerprints(jobs) != before


def test_what_is_done_is_kept(tmp_path: Path):
    for name in ("same", "other", "failed"):
        (tmp_path / name).mkdir()
    lines = [line("same"), line("other"), line("failed", "failed"), line("gone")]
    digests = {"same": "x", "other": "y", "failed": "x", "gone": "x", "new": "x"}
    assert [*still_valid({each.job: each for each in lines}, digests, tmp_path)] == ["same"]


def test_the_journal_outlives_a_torn_line(tmp_path: Path, said: list[str]):
    journal = JobJournal(tmp_path, [line("a")])
    journal.add(line("b"))
    journal.add(line("b", "failed"))
    with (tmp_path / JOURNAL).open("a") as file:
        file.write('{"job": "c", "sta')
    found = read_journal(tmp_path)
    assert {name: each.status for name, each in found.items()} == {"a": "done", "b": "failed"}
    assert "that cannot be read: 1." in said[0]
    JobJournal(tmp_path, found.values()).add(line("c"))
    assert [*read_journal(tmp_path)] == ["a", "b", "c"]
    assert read_journal(tmp_path / "nowhere") == {}


def test_jobs_follow_the_ones_they_need(tmp_path: Path):
    todo = planned(tmp_path, TEXT)
    crew = Pretended(1)
    assert [status for _, status in run(todo, crew)] == [0] * 4
    assert crew.begun == [*todo], "a scene is finished before the next one begins"
    crew = Pretended(2)
    run(todo, crew)
    assert crew.begun[:2] == ["garden-stylize", "desk-stylize"], "two work, each where it can"


def test_a_failure_costs_what_follows_it_only(tmp_path: Path):
    todo = planned(tmp_path, TEXT)
    ended = dict(run(todo, Pretended(2, lambda name: int(name == "garden-stylize"))))
    assert ended == {
        "garden-stylize": 1,
        "garden-stylize-export": "garden-stylize",
        "desk-stylize": 0,
        "desk-stylize-export": 0,
    }


def test_what_follows_a_job_that_is_done_is_run(tmp_path: Path):
    todo = planned(tmp_path, TEXT)
    todo.pop("garden-stylize")
    crew = Pretended(1)
    run(todo, crew, "garden-stylize")
    assert crew.begun[0] == "garden-stylize-export"

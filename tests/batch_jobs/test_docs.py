"""The job files in the documentation are job files."""

import re
from pathlib import Path

import pytest

from processes import VERBS
from stylesplat.batch_jobs.job_file import plan_batch

TEXT = (Path(__file__).parents[2] / "docs" / "batch.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize(("number", "count"), [(0, 24), (1, 2 * (1 + 1 + 6))])
def test_an_example_is_planned(number: int, count: int, tmp_path: Path):
    for folder in ("garden", "desk"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "scene.json").write_text("{}")
        (tmp_path / "photos" / folder).mkdir(parents=True)
        (tmp_path / "photos" / folder / "transforms.json").write_text("{}")
    for name in ("wave.jpg", "starry.jpg", "night.jpg", "desk.ply"):
        (tmp_path / name).touch()
    path = tmp_path / "jobs.yaml"
    path.write_text(EXAMPLES[number])
    jobs = plan_batch(path, VERBS)
    assert len(jobs) == count
    if number == 0:
        told = re.findall(r"^results/(garden\S+?)/", TEXT, re.MULTILINE)
        assert told and {*told} <= {job.name for job in jobs}


def test_all_examples_are_tried():
    assert len(EXAMPLES) == 2
    assert all(verb in TEXT for verb in VERBS)

"""Batches as processes: what is made, what a failure costs, what is run again."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import stylesplat as ss
from capture_files import write_ball_capture
from processes import LIMIT, complaint, is_running, result, wait_until
from stylesplat.batch_jobs.run_batch import RECORDS, read_records
from stylesplat.cli.command import CONTINUES

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's /proc")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(ss.__file__).parents[1])}
RENDER = "{view: 0001.jpg, what: depth, device: cpu}"


def write(scene: Path, jobs: str) -> Path:
    path = scene.with_name("jobs.yaml")
    path.write_text(f"scenes: [{scene.name}]\njobs:\n{jobs}")
    return path


def test_good_and_bad_jobs(scene: Path, tmp_path: Path, capsys):
    jobs = write(
        scene,
        "  - select: {name: [red], id: [3, 999]}\n    then:\n"
        f"      - render: {RENDER}\n        needs: {{cpus: 1}}\n",
    )
    out = tmp_path / "out"
    line = complaint(capsys, "batch", jobs, "-o", out, "--workers", 2)
    assert "1 of 4 jobs failed (1 behind them skipped): scene-select-id-999: Object 999" in line
    lines = read_records(out / RECORDS)
    done = {name for name, each in lines.items() if each.status == "done"}
    good = "scene-select-id-3"
    assert done == {good, f"{good}-render"}
    assert lines[good].result["name"] == "red" and lines[good].threads >= 1
    assert (lines[good].memory_gb or 0) > 0.05
    assert (out / f"{good}-render" / "0001.png").is_file()
    page = (out / "jobs.html").read_text()
    assert page.count("data:image/jpeg") == 2 and page.count("skipped") > 2 and "999" in page
    assert (scene / "objects.json").read_text().count("red") == 0, "scenes stay as they are"

    before = (out / f"{good}-render" / "0001.png").stat().st_mtime_ns
    again = ss.batch(jobs, out)
    assert again.kept == 2 and len(again.of("failed")) == 1
    assert (out / f"{good}-render" / "0001.png").stat().st_mtime_ns == before
    assert repr(again) == "BatchResult(4 jobs, 2 done, 1 failed, 1 skipped)"


def test_a_folder_of_others_is_left_alone(scene: Path, tmp_path: Path, capsys):
    jobs, out = write(scene, "  - render: {}\n"), tmp_path / "x"
    for call, fault in (
        ((jobs, "-o", scene), "no result of jobs"),
        ((jobs, "-o", out, "--workers", 0), "at least one worker"),
        ((jobs, "-o", out, "--workers", 2, "--ray", "local"), "Leave out --workers"),
        ((jobs, "-o", "s3://bucket/results"), "is an address"),
        (("gs://bucket/jobs.yaml", "-o", out), "is an address"),
        ((tmp_path / "no.yaml", "-o", out), "No such file"),
    ):
        assert fault in complaint(capsys, "batch", *call)
    assert not out.exists()


@pytest.fixture
def begun(tmp_path: Path) -> Iterator[Callable[[Path], tuple[subprocess.Popen[str], int]]]:
    """Start a batch; it, and the process of its first job."""
    batches: list[subprocess.Popen[str]] = []

    def begin(jobs: Path) -> tuple[subprocess.Popen[str], int]:
        command = [sys.executable, "-m", "stylesplat", "batch", str(jobs), "-o", tmp_path / "out"]
        batch = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
        batches.append(batch)

        def children() -> list[str]:
            files = Path(f"/proc/{batch.pid}/task").glob("*/children")
            return [pid for file in files for pid in file.read_text().split()]

        wait_until(lambda: [*tmp_path.glob("out/logs/*.log")] and children(), batch)
        return batch, int(children()[-1])

    yield begin
    for batch in batches:
        batch.kill()
        batch.communicate(timeout=60)


@LINUX
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_an_end_takes_the_children_along(name: str, begun, scene: Path):
    batch, child = begun(write(scene, "  - render: {views: orbit}\n"))
    batch.send_signal(signal.Signals[name])
    _, said = batch.communicate(timeout=LIMIT)
    last = time.monotonic() + LIMIT
    while is_running(child) and time.monotonic() < last:
        time.sleep(0.05)
    assert not is_running(child)
    assert (scene.with_name("out") / RECORDS).read_text() == ""
    if name == "SIGINT":
        assert batch.returncode == 130
        assert said.splitlines()[-1] == f"stylesplat: interrupted. {CONTINUES}"


@LINUX
def test_a_killed_job_costs_one_job(begun, scene: Path):
    batch, child = begun(write(scene, "  - render: {views: test, downscale: [0.5, 4]}\n"))
    os.kill(child, signal.SIGKILL)
    batch.communicate(timeout=LIMIT)
    assert batch.returncode == 1
    records = (scene.with_name("out") / RECORDS).read_text()
    found = [json.loads(line) for line in records.splitlines()]
    assert [each["status"] for each in found] == ["failed", "done"]
    assert "it was killed, perhaps because memory ran out" in found[0]["reason"]


def test_masks_are_made_on_a_copy(tmp_path: Path, capsys):
    """The photos' own folder stays as it is, also if another program edits the copy in place."""
    capture = write_ball_capture(tmp_path / "capture")
    maps = (capture / "object_mask").rename(tmp_path / "maps")
    path = tmp_path / "jobs.yaml"
    path.write_text(f"scenes: {{balls: {capture}}}\njobs: [{{mask: {{from: {maps}}}}}]\n")
    before = {p: p.stat().st_mtime_ns for p in capture.rglob("*")}
    found = result(capsys, "batch", path, "-o", tmp_path / "out")
    assert [each["status"] for each in found["jobs"]] == ["done"], found
    assert {p: p.stat().st_mtime_ns for p in capture.rglob("*")} == before
    made = tmp_path / "out" / "balls-mask"
    assert (made / "object_mask" / "0001.png").is_file() and (made / "transforms.json").is_file()
    (photo, *_) = sorted((capture / "images").iterdir())
    copy = made / photo.relative_to(capture)
    assert copy.read_bytes() == photo.read_bytes()
    copy.write_bytes(b"edited")
    assert photo.read_bytes() != b"edited"

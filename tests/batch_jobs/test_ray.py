"""Jobs as Ray tasks: resources, clusters that cannot be reached, and a node that dies."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import stylesplat as ss
from processes import complaint, planned, wait_until
from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_process import JobRecord, ended_job
from stylesplat.batch_jobs.ray_tasks import ray_resources, refuse_oversized
from stylesplat.batch_jobs.run_batch import RECORDS
from stylesplat.errors import StyleSplatError

NODES = Path(__file__).parents[1] / "ray_nodes.py"
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(Path(ss.__file__).parents[1]), *filter(None, sys.path)]),
}
HAS_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra stylesplat[ray]")


def test_resources_are_those_of_the_job_file(tmp_path: Path):
    text = (
        "scenes: [garden]\njobs:\n  - render: {}\n"
        "  - stylize: {style: {a: wave.jpg}, device: cuda}\n    needs: {cpus: 3, memory: 7.5}\n"
    )
    render, stylize = planned(tmp_path, text).values()
    assert ray_resources(render) == {"num_cpus": 1, "num_gpus": 0}
    assert ray_resources(stylize) == {"num_cpus": 3, "num_gpus": 1, "memory": 7_500_000_000}
    small, large = {"CPU": 2.0, "memory": 4e9}, {"CPU": 4.0, "GPU": 1.0, "memory": 8e9}
    refuse_oversized(render, [small])
    refuse_oversized(stylize, [small, large])
    with pytest.raises(StyleSplatError, match=f"{stylize.name} needs CPU 3, GPU 1"):
        refuse_oversized(stylize, [small, {**large, "memory": 7e9}])


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A module in place of Ray's, whose tasks run when they are asked for."""
    ray: Any = ModuleType("ray")
    ray.exceptions = SimpleNamespace(RayError=type("RayError", (Exception,), {}))
    ray.is_initialized = lambda: False
    ray.init, ray.ended = lambda **options: None, []
    alive = {"Alive": True, "Resources": {"CPU": 2.0}}
    ray.nodes = lambda: [alive, {"Alive": False, "Resources": {"CPU": 99.0}}]
    ray.remote = lambda function: SimpleNamespace(
        options=lambda **_: SimpleNamespace(remote=lambda *words: (function, words))
    )
    ray.get = lambda task: task[0](*task[1])
    ray.cancel = lambda task: ray.ended.append(task[1][0].name)
    ray.shutdown = lambda: ray.ended.append("all")
    monkeypatch.setitem(sys.modules, "ray", ray)
    return ray


def test_something_else_answers(stand_in: Any, scene: Path, capsys):
    def fail(**_: object) -> None:
        fact = "Failed to connect to 10.0.0.1. See the manual.\nIt may help."
        raise stand_in.exceptions.RayError(fact)

    stand_in.init = fail
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = refused(scene, capsys, f"127.0.0.1:{server.getsockname()[1]}")
    assert ": Failed to connect to 10.0.0.1. " in line and "manual" not in line


def test_what_tasks_answer(stand_in: Any, scene: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    """One is done; one has written where nobody sees it, one fails, and one fits nowhere."""

    def work(job: Job, output: Path, threads: int) -> JobRecord:
        if job.name.endswith("2"):
            raise RuntimeError("the worker died")
        if job.name.endswith("1"):
            (output / job.name).mkdir()
        return ended_job(job, "done", f"{threads} threads")

    monkeypatch.setattr("stylesplat.batch_jobs.ray_tasks.run_job", work)
    jobs, out = scene.with_name("jobs.yaml"), scene.with_name("out")
    text = "scenes: [scene]\njobs: [{render: {downscale: [1, 2, 4]}, needs: {cpus: %d}}]\n"
    jobs.write_text(text % 2)
    done, died, elsewhere = ss.batch(jobs, out, ray="local").jobs
    assert (done.status, done.reason, done.node) == ("done", "2 threads", socket.gethostname())
    assert (died.status, elsewhere.status) == ("failed", "failed")
    assert "Ray task failed: the worker died" in died.reason
    assert f"another {out}" in elsewhere.reason
    *each, last = stand_in.ended
    assert sorted(each) == sorted([done.job, died.job, elsewhere.job]) and last == "all"
    jobs.write_text(text % 64)
    line = complaint(capsys, "batch", jobs, "-o", out, "--ray", "local")
    assert "needs CPU 64, and no node" in line and stand_in.ended[-2:] == ["all", "all"]


def refused(scene: Path, capsys, address: str) -> str:
    jobs = scene.with_name("jobs.yaml")
    jobs.write_text("scenes: [scene]\njobs: [{render: {}}]\n")
    return complaint(capsys, "batch", jobs, "-o", scene.with_name("out"), "--ray", address)


@pytest.mark.parametrize("address", ["localhost:1", "ray://localhost:1", "here"])
def test_a_cluster_that_is_not_there(address: str, scene: Path, capsys):
    assert f"Cannot reach a Ray cluster at {address}: " in refused(scene, capsys, address)


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray(scene: Path, capsys):
    assert "pip install 'stylesplat[ray]'" in refused(scene, capsys, "local")


@pytest.fixture
def nodes() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Two nodes with a core each: their process, and the address."""
    process = subprocess.Popen(
        [sys.executable, NODES],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout
    address = next(line for line in process.stdout if line.startswith("address")).split()[1]
    yield process, address
    process.communicate(timeout=60)


@HAS_RAY
def test_a_node_that_dies_costs_nothing(nodes, scene: Path, tmp_path: Path):
    cluster, address = nodes
    jobs = tmp_path / "jobs.yaml"
    sizes = "[0.1, 0.12, 0.14, 0.16]"
    jobs.write_text(
        f"scenes: [scene]\njobs:\n  - render: {{device: cpu, downscale: {sizes}}}\n"
        "    needs: {memory: 1}\n"
    )
    out = tmp_path / "out"
    command = [sys.executable, "-m", "stylesplat", "batch", jobs, "-o", out, "--ray", address]
    batch = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: len([*(out / "logs").glob("*.log")]) >= 2, batch)
    time.sleep(1)  # both are at work by now
    cluster.stdin.write("kill\n")
    cluster.stdin.flush()
    assert cluster.stdout.readline() == "killed\n"
    _, said = batch.communicate(timeout=120)
    assert batch.returncode == 0, said
    lines = [json.loads(line) for line in (out / RECORDS).read_text().splitlines()]
    assert len(lines) == 4 and {line["status"] for line in lines} == {"done"}, "none twice"
    assert {line["job"] for line in lines} == {p.name for p in out.glob("scene-*")}

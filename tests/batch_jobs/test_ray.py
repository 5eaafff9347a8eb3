"""Jobs as Ray tasks: nodes that are unfit, and one that dies."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import stylesplat as ss
from command_line import complaint
from job_files import planned, write_jobs
from stylesplat.batch_jobs import ray_cluster
from stylesplat.batch_jobs.job_journal import JOURNAL
from stylesplat.batch_jobs.job_needs import MEASURED, Room, gaussians_at, rooms_of
from stylesplat.batch_jobs.ray_cluster import check_fits, check_nodes, connect
from stylesplat.errors import StyleSplatError
from waits import wait_until

NODES = Path(__file__).parents[1] / "ray_nodes.py"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(ss.__file__).parents[1])}
SCENE = "scenes: [garden]\njobs:\n"
HAS_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra stylesplat[ray]")


def test_what_jobs_take(tmp_path: Path):
    text = (
        SCENE + "  - render: {}\n    then: []\n  - stylize: {style: {a: wave.jpg}, device: cuda}\n"
        "    needs: {cpus: 3, memory: 7.5}\n    then: [{export: {output: a.ply}}]\n"
    )
    write_jobs(tmp_path, text)
    (tmp_path / "garden" / "splats.ply").write_bytes(bytes(248 * 1000))
    render, stylize, export = rooms_of([*planned(tmp_path, text).values()], tmp_path).values()
    assert gaussians_at(tmp_path / "garden") == 1000
    assert render == Room(1, 0, MEASURED["render"].alone)
    assert stylize == Room(3, 1, 7.5)
    assert export.memory_gb == MEASURED["export"].alone
    assert str(stylize) == "3 CPUs, 1 GPU and 7.5 GB"


def test_a_job_that_fits_nowhere_is_refused():
    nodes = [Room(2, 0, 4.0), Room(8, 0, 2.0)]
    check_fits({"a": Room(2, 0, 4.0), "b": Room(8, 0, 1.0)}, nodes)
    for large in (Room(8, 0, 3.0), Room(1, 1, 1.0)):
        with pytest.raises(StyleSplatError, match=r"c takes .*; no node has that, the largest"):
            check_fits({"c": large}, nodes)


class RayError(Exception):
    pass


@pytest.mark.parametrize(
    ("answer", "fault"),
    [
        ((version("stylesplat"), True), None),
        (("0.0.9", True), "Ray node one has stylesplat 0.0.9, here is "),
        (("", False), "Ray node one has no stylesplat"),
        ((version("stylesplat"), False), "Ray node one does not see "),
        (RayError("gone"), "does not answer: gone"),
    ],
)
def test_nodes_that_are_unfit(answer, fault: str | None, tmp_path: Path, monkeypatch):
    def get(references: object, timeout: float) -> list[object]:
        if isinstance(answer, Exception):
            raise answer
        return [answer]

    node = {"Alive": True, "NodeID": "1", "NodeManagerHostname": "one", "Resources": {}}
    dead = {**node, "Alive": False}
    errors = SimpleNamespace(RayError=RayError)
    ray = ModuleType("ray")
    vars(ray).update(nodes=lambda: [dead, node], get=get, exceptions=errors)
    monkeypatch.setattr(ray_cluster, "_asked", lambda ray, marker: [1])
    if fault is None:
        check_nodes(ray, tmp_path / JOURNAL)
        return
    with pytest.raises(StyleSplatError, match=fault):
        check_nodes(ray, tmp_path / JOURNAL)


STAND_IN = """
import os
from types import SimpleNamespace
class RayError(Exception):
    pass
exceptions = SimpleNamespace(RayError=RayError)
def is_initialized():
    return False
def init(**_):
    os.write(2, b"here" if os.getpid() == {pid} else b"gcs_client.cc:210: Failed at this try")
    if {fails}:
        raise {kind}("Failed to connect to 10.0.0.1. See the manual.\\nIt may help.")
"""


@pytest.fixture
def answering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Puts a stand-in in place of Ray, and gives an address where something answers."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def stand_in(*, fails: bool, kind: str = "OSError") -> str:
            text = STAND_IN.format(pid=os.getpid(), fails=fails, kind=kind)
            (tmp_path / "ray.py").write_text(text)
            return f"127.0.0.1:{server.getsockname()[1]}"

        yield stand_in
    sys.modules.pop("ray", None)


@pytest.mark.parametrize("kind", ["ConnectionError", "RayError"])
def test_something_else_answers(kind: str, answering, capfd):
    address = answering(fails=True, kind=kind)
    with pytest.raises(StyleSplatError, match=r": Failed to connect to 10\.0\.0\.1\. Somet"):
        connect(address)
    assert capfd.readouterr().err == "", "what Ray prints at every try is not shown"


def test_what_others_write_meanwhile_is_not_lost(answering, capfd):
    """Standard error is one for all threads of the process."""
    connect(answering(fails=False))
    assert capfd.readouterr().err == "here"


@pytest.mark.parametrize(
    ("address", "fault"),
    [
        ("localhost:1", "Cannot reach a Ray cluster at localhost:1: Connection refused"),
        ("ray://localhost:1", "Cannot reach a Ray cluster at ray://localhost:1: "),
        ("here", "'here' is no address of a Ray cluster"),
    ],
)
def test_a_cluster_that_is_not_there(address: str, fault: str, scene: Path, capsys):
    jobs = scene.with_name("jobs.yaml")
    jobs.write_text("scenes: [scene]\njobs: [{render: {}}]\n")
    line = complaint(capsys, "batch", jobs, "-o", scene.with_name("out"), "--ray", address)
    assert fault in line
    two = ("--ray", address, "--workers", 2)
    assert "--workers out" in complaint(capsys, "batch", jobs, "-o", scene.with_name("out"), *two)


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray(scene: Path, capsys):
    jobs = scene.with_name("jobs.yaml")
    jobs.write_text("scenes: [scene]\njobs: [{render: {}}]\n")
    line = complaint(capsys, "batch", jobs, "-o", scene.with_name("out"), "--ray", "local")
    assert "pip install 'stylesplat[ray]'" in line


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
    out, alone = tmp_path / "out", tmp_path / "alone"
    command = [sys.executable, "-m", "stylesplat", "batch", jobs, "-o", out, "--ray", address]
    batch = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: len([*(out / "logs").glob("*.log")]) >= 2, batch)
    time.sleep(1)  # both are at work by now
    cluster.stdin.write("kill\n")
    cluster.stdin.flush()
    assert cluster.stdout.readline() == "killed\n"
    _, said = batch.communicate(timeout=120)
    assert batch.returncode == 0, said
    lines = [json.loads(line) for line in (out / JOURNAL).read_text().splitlines()]
    assert len(lines) == 4 and {line["status"] for line in lines} == {"done"}, "none twice"
    assert {line["job"] for line in lines} == {p.name for p in out.glob("scene-*")}
    name = "scene-render-downscale-0.16"
    single = subprocess.run(
        [sys.executable, "-m", "stylesplat", "render", scene, "-o", alone, "--downscale", "0.16"],
        env=ENVIRONMENT | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
        capture_output=True,
        timeout=120,
    )
    assert single.returncode == 0
    pictures = sorted(alone.glob("*.png"))
    assert pictures
    assert all(p.read_bytes() == (out / name / p.name).read_bytes() for p in pictures)

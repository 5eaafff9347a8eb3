"""Runs jobs as Ray tasks: Ray finds a node with the resources that the job file names."""

import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from msgspec.structs import replace

from stylesplat.batch_jobs.job import Job
from stylesplat.batch_jobs.job_process import JobRecord, RunJob, ended_job, run_job
from stylesplat.errors import StyleSplatError
from stylesplat.interrupts import preserve_signal_handlers
from stylesplat.io.files import reason

LOCAL = "local"
RESOURCES = {"num_cpus": "CPU", "num_gpus": "GPU", "memory": "memory"}  # as nodes name them
HERE = ("auto", LOCAL)  # addresses that name no machine
ANSWER = 5.0  # seconds in which a machine must accept a connection: Ray itself tries for a minute
STORE = 100 * 2**20  # bytes of the object store of a local cluster: results are small
MOST_TASKS = 1000  # at a time: a thread of this process waits for each
RETRIES = 3  # times that Ray runs a job again after its node or its worker has died
RAY_REMEDY = (
    "Use auto, HOST:6379 or ray://HOST:10001 for a cluster that `ray start --head` has started "
    "(with RAY_AUTH_TOKEN, if it asks for a token), or --ray local."
)


@contextmanager
def ray_tasks(jobs: Sequence[Job], output: Path, address: str) -> Iterator[RunJob]:
    """Yields what runs a job on a cluster, whose nodes share the output folder."""
    ray, is_ours = _connect(address)
    tasks: list[Any] = []

    def run(job: Job) -> JobRecord:
        resources = ray_resources(job)
        remote = ray.remote(_run_on_node).options(name=job.name, max_retries=RETRIES, **resources)
        task = remote.remote(job, output, resources["num_cpus"], version("stylesplat"))
        tasks.append(task)
        try:
            record: JobRecord = ray.get(task)
        except Exception as error:  # of Ray, or of the task
            return ended_job(job, "failed", f"its Ray task failed: {reason(error)}.")
        if record.status == "done" and not (output / job.name).exists():
            fault = f"the Ray node {record.node} has written to another {output} than that of here."
            remedy = "Use a folder that all nodes share."
            return replace(record, status="failed", reason=f"{fault} {remedy}")
        return record

    try:
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        for job in jobs:
            refuse_oversized(job, nodes)
        yield run
    finally:
        for task in tasks:
            ray.cancel(task)  # which does nothing to those that are done
        if is_ours:
            ray.shutdown()


def ray_resources(job: Job) -> dict[str, int]:
    """What a job asks Ray for: one core, unless the job file says otherwise."""
    device, needs = job.values.get("device"), job.needs
    on_gpu = device is not None and device.words == ("cuda",)
    gpus = int(on_gpu) if needs.gpus is None else needs.gpus
    memory = {"memory": int(needs.memory * 1e9)} if needs.memory else {}
    return {"num_cpus": needs.cpus or 1, "num_gpus": gpus, **memory}


def refuse_oversized(job: Job, nodes: Sequence[Mapping[str, float]]) -> None:
    """Refuse a job that fits on no node: Ray would wait for one forever."""
    wanted = {RESOURCES[key]: number for key, number in ray_resources(job).items() if number}
    if not any(all(node.get(key, 0) >= wanted[key] for key in wanted) for node in nodes):
        gb = {"memory": f"{job.needs.memory} GB"}
        asked = ", ".join(f"{key} {gb.get(key, number)}" for key, number in wanted.items())
        raise StyleSplatError(
            f"{job.name} needs {asked}, and no node of the Ray cluster has that. Change `needs:` "
            "in the job file, or add a larger node."
        )


def _run_on_node(job: Job, output: Path, threads: int, expected: str) -> JobRecord:
    node, found = socket.gethostname(), version("stylesplat")
    if found != expected:
        fault = f"the Ray node {node} has stylesplat {found}, here is {expected}. Install the same."
        return ended_job(job, "failed", fault)
    return replace(run_job(job, output, threads), node=node)


def _connect(address: str) -> tuple[ModuleType, bool]:
    """Ray, and whether this call has connected it: a program may be connected already."""
    if address not in HERE:  # Ray itself tries for a minute
        host, _, port = address.rpartition("://")[2].rpartition(":")
        try:
            socket.create_connection((host, int(port)), timeout=ANSWER).close()
        except (OSError, OverflowError, ValueError) as error:
            raise _unreachable(address, error) from error
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # we report nothing to anybody
    try:
        ray = import_module("ray")
    except ImportError as error:
        raise StyleSplatError(
            "Ray is not installed. `pip install 'stylesplat[ray]'`, or leave --ray out."
        ) from error
    if ray.is_initialized():
        return ray, False
    options: dict[str, Any] = {"address": address, "log_to_driver": False}
    if address == LOCAL:
        os.environ.setdefault("RAY_worker_niceness", "0")  # else 15: `--workers` has 0
        options |= {"include_dashboard": False, "object_store_memory": STORE}
    try:
        with preserve_signal_handlers():
            ray.init(logging_level="ERROR", **options)
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise _unreachable(address, error) from error
    return ray, True


def _unreachable(address: str, error: Exception) -> StyleSplatError:
    fact = " ".join(str(error).split()).partition(". ")[0].rstrip(".")
    return StyleSplatError(f"Cannot reach a Ray cluster at {address}: {fact}. {RAY_REMEDY}")

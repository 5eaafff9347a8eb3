"""A Ray cluster: reached, with this package on every node, and large enough."""

import os
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from stylesplat.batch_jobs.job_needs import Room
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.signals import kept_signals

LOCAL = "local"
HERE = ("auto", LOCAL)  # addresses that name no machine
ANSWER = 5.0  # seconds in which a machine must answer at all
SURVEY = 120.0  # seconds in which all nodes must: the first task there starts Python
STORE = 100 * 2**20  # bytes of the object store of a local cluster: results are small
START = "Start one with `ray start --head`, or use --ray local."
TRY = """
import sys, ray
try:
    ray.init(address=sys.argv[1], log_to_driver=False, logging_level="ERROR")
except Exception as error:
    print(error)
    sys.exit(1)
"""
TOKEN = (
    "Something answers there: if it is a cluster that asks for a token, set RAY_AUTH_MODE=token "
    "and RAY_AUTH_TOKEN."
)


def connect(address: str) -> tuple[ModuleType, bool]:
    """Connect to a cluster, or start one on this machine.

    Args:
        address: `local`, `auto`, `HOST:PORT` or `ray://HOST:PORT`.

    Returns:
        Ray, and whether this connected it: a program that uses Ray already keeps its cluster.

    Raises:
        StyleSplatError: If Ray is missing, or nothing answers there.
    """
    _knock(address)
    ray = _ray()
    if ray.is_initialized():
        return ray, False
    options: dict[str, Any] = {"address": address}
    if address == LOCAL:
        os.environ.setdefault("RAY_worker_niceness", "0")  # else 15: `--workers` has 0
        options |= {"include_dashboard": False, "object_store_memory": STORE}
    try:
        if address != LOCAL:
            _try(address)
        with kept_signals():
            ray.init(log_to_driver=False, logging_level="ERROR", **options)
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        said = " ".join(str(error).split()).partition(". ")[0].rstrip(".")
        remedy = START if address in HERE else TOKEN
        raise StyleSplatError(
            f"Cannot reach a Ray cluster at {address}: {said}. {remedy}"
        ) from error
    return ray, True


def _try(address: str) -> None:
    """Raise a ConnectionError if no cluster answers.

    In a process of its own, for Ray's native part prints at each try, and may end the process.
    """
    command = [sys.executable, "-P", "-c", TRY, address]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    if done.returncode:
        raise ConnectionError(done.stdout or f"Ray ended with status {done.returncode}")


def rooms(ray: ModuleType) -> list[Room]:
    """What each node that is alive has."""
    return [_room(node["Resources"]) for node in _alive(ray)]


def check_nodes(ray: ModuleType, marker: Path) -> None:
    """Make sure that all nodes have this version, and see the folder of results.

    Args:
        ray: Connected.
        marker: A file in that folder.

    Raises:
        StyleSplatError: If one does not, or does not answer.
    """
    names = [node["NodeManagerHostname"] for node in _alive(ray)]
    try:
        found = ray.get(_asked(ray, str(marker)), timeout=SURVEY)
    except ray.exceptions.RayError as error:
        raise StyleSplatError(
            f"A node of the Ray cluster does not answer: {reason(error)}. See `ray status`."
        ) from error
    mine = version("stylesplat")
    for name, (theirs, sees) in zip(names, found, strict=True):
        if theirs != mine:
            has = f"stylesplat {theirs}" if theirs else "no stylesplat"
            raise StyleSplatError(
                f"The Ray node {name} has {has}, here is {mine}. Install the same version there."
            )
        if not sees:
            raise StyleSplatError(
                f"The Ray node {name} does not see {marker.parent}. Use a folder that all nodes "
                "share, by the same path."
            )


def check_fits(wanted: Mapping[str, Room], rooms: Sequence[Room]) -> None:
    """Refuse jobs that are larger than any node.

    Args:
        wanted: What jobs take, by name.
        rooms: What nodes have.

    Raises:
        StyleSplatError: If one fits nowhere.
    """
    for name, room in wanted.items():
        if not any(room.fits(other) for other in rooms):
            largest = max(rooms, key=lambda other: (other.gpus, other.memory_gb, other.cpus))
            raise StyleSplatError(
                f"{name} takes {room}; no node has that, the largest has {largest}. Say what it "
                "really takes with `needs:` in the job file, or add a larger node."
            )


def _asked(ray: ModuleType, marker: str) -> list[Any]:
    """Futures of each node's version, and whether it sees a file."""
    strategies = import_module("ray.util.scheduling_strategies")

    def look(path: str) -> tuple[str, bool]:  # sent as it is: the package may not be there
        import os
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("stylesplat"), os.path.exists(path)  # noqa: PTH110
        except PackageNotFoundError:
            return "", False

    remote = ray.remote(num_cpus=0, max_retries=0)(look)
    at = (
        strategies.NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        for node in _alive(ray)
    )
    return [remote.options(scheduling_strategy=each).remote(marker) for each in at]


def _alive(ray: ModuleType) -> list[dict[str, Any]]:
    return sorted((n for n in ray.nodes() if n["Alive"]), key=lambda node: node["NodeID"])


def _room(resources: Mapping[str, float]) -> Room:
    memory = resources.get("memory", 0.0) / 1e9
    return Room(int(resources.get("CPU", 0)), int(resources.get("GPU", 0)), memory)


def _knock(address: str) -> None:
    """Raise a StyleSplatError at once where nothing listens: Ray itself tries for a minute."""
    if address in HERE:
        return
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if not (host and colon and port.isdecimal()):
        raise StyleSplatError(
            f"{address!r} is no address of a Ray cluster. Use local, auto, HOST:6379 or "
            "ray://HOST:10001."
        )
    try:
        socket.create_connection((host, int(port)), timeout=ANSWER).close()
    except (OSError, OverflowError) as error:
        said = getattr(error, "strerror", None) or reason(error)
        raise StyleSplatError(
            f"Cannot reach a Ray cluster at {address}: {said}. {START}"
        ) from error


def _ray() -> ModuleType:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # we report nothing to anybody
    try:
        return import_module("ray")
    except ImportError as error:
        raise StyleSplatError(
            "Ray is not installed. `pip install 'stylesplat[ray]'`, or leave --ray out."
        ) from error

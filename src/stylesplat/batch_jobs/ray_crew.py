"""Jobs as Ray tasks: Ray finds a node with room for each, and another one if that node dies."""

import socket
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.batch_jobs.job_journal import JOURNAL
from stylesplat.batch_jobs.job_needs import rooms_of
from stylesplat.batch_jobs.orders import Order, Outcome, at_node, order_of, run_order
from stylesplat.batch_jobs.ray_cluster import check_fits, check_nodes, connect, rooms
from stylesplat.io.files import reason

RETRIES = 3  # times that a job is begun anew where a node or a worker has died
PAUSE = 0.5  # seconds to wait for a task before others may begin
DIED = 1  # the status of a job that has ended without one


class RayCrew:
    """The nodes of a cluster."""

    def __init__(self, todo: Sequence[Job], output: Path, address: str) -> None:
        """Connect to a cluster, and see whether it can do what there is to do.

        Raises:
            StyleSplatError: If it cannot be reached, or a node has another version, does not see
                the folder, or none is large enough for a job.
        """
        self._output, self._rooms = output, rooms_of(todo, output)
        self._ray, self._own = connect(address)
        try:
            check_nodes(self._ray, output / JOURNAL)
            check_fits(self._rooms, rooms(self._ray))
        except BaseException:
            self.close()
            raise
        self._remote = self._ray.remote(_run)
        self._running: dict[Any, Job] = {}

    def threads_of(self, job: Job) -> int:
        """As many as it has cores."""
        return self._rooms[job.name].cpus

    @property
    def has_room(self) -> bool:
        """Ray itself has jobs wait."""
        return True

    @property
    def at_work(self) -> Sequence[str]:
        """The names of the jobs that Ray has got."""
        return [job.name for job in self._running.values()]

    def begin(self, job: Job) -> None:
        """Hand a job to Ray."""
        room = self._rooms[job.name]
        order = order_of(job, self._output, threads=room.cpus)
        task = self._remote.options(
            name=job.name,
            num_cpus=room.cpus,
            num_gpus=room.gpus,
            memory=int(room.memory_gb * 1e9),
            max_retries=RETRIES,
        )
        self._running[task.remote(order)] = job

    def ended(self) -> Iterator[tuple[Job, Outcome]]:
        """Wait a moment for tasks to end."""
        ready, _ = self._ray.wait([*self._running], num_returns=1, timeout=PAUSE)
        for reference in ready:
            job = self._running.pop(reference)
            try:
                yield job, self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                said = f"its node or its worker died {RETRIES + 1} times: {reason(error)}"
                yield job, Outcome(DIED, 0.0, said, {}, None)

    def close(self) -> None:
        """Take back what is not done, and leave the cluster."""
        for reference in getattr(self, "_running", {}):
            self._ray.cancel(reference)
        if self._own:
            self._ray.shutdown()


def _run(order: Order) -> Outcome:
    """What a node does."""
    return at_node(run_order(order), socket.gethostname())

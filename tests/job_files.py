"""Job files, and a crew that only pretends to work."""

from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent

from stylesplat.batch_jobs.batch_plan import Job, plan_batch
from stylesplat.batch_jobs.orders import Outcome
from stylesplat.cli.batch_verbs import batch_verbs

VERBS = batch_verbs()


def write_jobs(folder: Path, text: str) -> Path:
    """A job file beside two scenes and pictures that only have their names."""
    parts = [
        f"{name}/{part}" for name in ("garden", "desk") for part in ("scene.json", "splats.ply")
    ]
    for name in (*parts, "wave.jpg", "night.jpg", "other/wave.jpg", "wave.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        if not (folder / name).exists():
            (folder / name).write_text(name)
    path = folder / "jobs.yaml"
    path.write_text(dedent(text))
    return path


def planned(folder: Path, text: str) -> dict[str, Job]:
    """The jobs of a file, by name."""
    return {job.name: job for job in plan_batch(write_jobs(folder, text), VERBS)}


class Pretended:
    """A crew of so many that ends jobs in turn, as it is told."""

    def __init__(self, size: int, ends: Callable[[str], int] = lambda name: 0) -> None:
        self._size, self._ends = size, ends
        self.begun: list[str] = []
        self._busy: list[Job] = []

    def threads_of(self, job: Job) -> int:
        return 1

    @property
    def has_room(self) -> bool:
        return len(self._busy) < self._size

    @property
    def at_work(self) -> list[str]:
        return [job.name for job in self._busy]

    def begin(self, job: Job) -> None:
        self.begun.append(job.name)
        self._busy.append(job)
        assert len(self._busy) <= self._size

    def ended(self) -> Iterator[tuple[Job, Outcome]]:
        job = self._busy.pop(0)
        yield job, Outcome(self._ends(job.name), 1.0, "", {}, None)

    def close(self) -> None:
        pass

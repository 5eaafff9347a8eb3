"""What a job takes of a machine, so that Ray can tell where there is room for it.

The numbers were measured on two cores of an AMD EPYC, with the demo's scene (60,000 Gaussians)
and 17 copies of it (1,020,000): the journal of a batch has the seconds and the memory of every
job. A job gets one core, for that makes the most of many: a second one makes a stylisation 1.8
times as fast, and a training 1.7 times.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

from stylesplat.batch_jobs.batch_plan import Job
from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import SOG_META


class Measured(NamedTuple):
    """The memory of a verb, GB, rounded up; of `train` what lies beyond 60,000 is reckoned."""

    alone: float
    """With a small scene."""
    per_million: float
    """More for each million Gaussians."""


MEASURED = {
    "train": Measured(2.3, 2.0),  # 1.14 with small photos; for a GPU it keeps 1 GiB of them
    "import": Measured(1.3, 0.6),
    "mask": Measured(2.3, 1.0),  # as it trains for a minute
    "select": Measured(1.3, 0.7),
    "stylize": Measured(2.9, 1.5),  # 1.32 as a draft; up to 1.5 GiB of prepared views
    "sheet": Measured(3.3, 1.5),  # as `stylize`, and 0.4 for the scene before
    "render": Measured(1.1, 1.0),
    "export": Measured(1.1, 0.9),
}
CORES = 1
BYTES = {  # of a file for each Gaussian, at least
    ".ply": 248,
    ".splat": 32,
    ".spz": 16,
    ".sog": 12,
    ".glb": 16,  # of one that does not say how many it has: as SPZ within it
    ".gltf": 21,
    ".json": 12,
}
GLTF = (".glb", ".gltf")
COMPRESSED, PACKED_BYTES = ".compressed.ply", 16  # SuperSplat's
TRAINED = 100_000  # Gaussians of a training that says nothing else
SPLATS_PLY = "splats.ply"  # in a scene


@dataclass(frozen=True)
class Room:
    """What a job takes, or a node has."""

    cpus: int
    gpus: int
    memory_gb: float

    def fits(self, other: "Room") -> bool:
        """Whether there is so much in another."""
        return (
            self.cpus <= other.cpus
            and self.gpus <= other.gpus
            and self.memory_gb <= other.memory_gb
        )

    def __str__(self) -> str:
        gpus = f", {self.gpus} GPU{'s' * (self.gpus > 1)}" if self.gpus else ""
        return f"{self.cpus} CPU{'s' * (self.cpus > 1)}{gpus} and {self.memory_gb:.1f} GB"


def rooms_of(jobs: Sequence[Job], output: Path) -> Mapping[str, Room]:
    """What each job takes, by name.

    Args:
        jobs: Each behind the one that it follows, if that is not done.
        output: The folder of results.
    """
    counts: dict[str, int] = {}
    rooms: dict[str, Room] = {}
    held = cache(gaussians_at)  # many jobs work on one scene
    for job in jobs:
        after = str(job.after)
        source = job.source or output / after
        count = counts[after] if after in counts else held(source)
        counts[job.name] = max(count, _trained(job)) if job.verb.name == "train" else count
        rooms[job.name] = _room(job, counts[job.name])
    return rooms


def gaussians_at(place: Path) -> int:
    """How many Gaussians a scene or a splat has at most, by the size of its file; 0 of photos.

    glTF, whose numbers may lie elsewhere, says it itself.
    """
    if (place / SPLATS_PLY).is_file():
        return (place / SPLATS_PLY).stat().st_size // BYTES[".ply"]
    if not place.is_file():
        return 0
    if place.suffix.lower() in GLTF and (announced := _announced(place)):
        return announced
    files = place.parent.iterdir() if place.name == SOG_META else [place]
    packed = place.name.lower().endswith(COMPRESSED)
    each = PACKED_BYTES if packed else BYTES.get(place.suffix.lower(), BYTES[".ply"])
    return sum(file.stat().st_size for file in files if file.is_file()) // each


def _announced(place: Path) -> int:
    """As many as a glTF file says; 0 of one that is damaged, which its job will tell."""
    from stylesplat.io.splats.read_gltf import announced_in_gltf  # loads torch

    with suppress(StyleSplatError):
        return announced_in_gltf(place)
    return 0


def _trained(job: Job) -> int:
    words = [c.words[0] for name, c in job.options if name == "max-gaussians" and c.words]
    return int(words[0]) if words else TRAINED


def _room(job: Job, count: int) -> Room:
    measured, needs = MEASURED[job.verb.name], job.needs
    on_gpu = any(name == "device" and choice.words == ("cuda",) for name, choice in job.options)
    memory = measured.alone + measured.per_million * count / 1e6
    return Room(
        needs.cpus or CORES,
        int(on_gpu) if needs.gpus is None else needs.gpus,
        needs.memory or round(job.processes * memory, 2),
    )

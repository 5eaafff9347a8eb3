"""The cells of a sheet as a batch of one scene: each a painted scene in a folder of its own."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stylesplat.batch_jobs.batch_plan import Job, jobs_of
from stylesplat.batch_jobs.job_file import Entry, Needs
from stylesplat.batch_jobs.job_names import parts_of
from stylesplat.batch_jobs.job_paths import path_in
from stylesplat.batch_jobs.run_batch import run_batch
from stylesplat.cli.batch import refuse_failed
from stylesplat.cli.batch_verbs import batch_verbs
from stylesplat.errors import StyleSplatError
from stylesplat.scene.scene import Scene

VERB = "stylize"
DEFAULT = "default"  # the preset in which an option that is left out is what null or false says
BLENDED = "intensity"  # the one setting whose values are blends of one painting


@dataclass(frozen=True)
class Cells:
    """What paints the cells of a sheet."""

    scene: Path
    """Its folder."""
    name: str
    """The object."""
    styles: Sequence[Sequence[Path]]
    """The pictures of each; several are alternatives."""
    vary: Mapping[str, Sequence[Any]]
    """Settings, or `preset`, and their values: the first makes columns, a second rows."""
    settings: Mapping[str, Any]
    """Options that all cells have."""

    def painted(self, folder: Path, workers: int) -> Iterator[Scene]:
        """The scene with each cell painted, in the order of `SheetPlan.runs`.

        Args:
            folder: Of the results; what an earlier run has painted there is kept.
            workers: Processes at a time.

        Raises:
            StyleSplatError: If the folder holds something else, or one cannot be painted.
        """
        from stylesplat.io.scene_folder import open

        jobs = self.jobs()
        refuse_failed(run_batch(jobs, folder, workers=workers))
        yield from (open(folder / job.name) for job in jobs)

    def jobs(self) -> tuple[Job, ...]:
        """Each cell as a job, but for those that are blends of others.

        Raises:
            StyleSplatError: If `stylize` cannot be told what varies.
        """
        varied = {_spelled(key): _listed(self.vary[key]) for key in [*self.vary][::-1]}
        varied.pop(BLENDED, None)
        for key in self._unsaid(varied):
            raise StyleSplatError(
                f"Cannot paint cells by `{VERB}`: it has no option that says all values of {key}. "
                "Leave --cells out, or vary something else."
            )
        styles = [*dict.fromkeys(map(tuple, self.styles))]
        parts = parts_of([[(self.name, each)] for each in styles])
        entries = [
            self._entry(part, each, varied) for part, each in zip(parts, styles, strict=True)
        ]
        return jobs_of(entries, Path())

    def _unsaid(self, varied: Mapping[str, Sequence[Any]]) -> Iterator[str]:
        """What varies in a way for which there is no option: null and false leave one out."""
        known = batch_verbs()[VERB].options
        presets = {self.settings.get("preset", DEFAULT), *varied.get("preset", ())}
        for key, values in varied.items():
            left_out = any(value is None or value is False for value in values)
            if key not in known or (left_out and presets != {DEFAULT}):
                yield key

    def _entry(self, part: str, pictures: Sequence[Path], varied: Mapping[str, Any]) -> Entry:
        """The cells of one style: lists of values multiply, as in job files."""
        place = path_in(Path(), str(self.scene))
        style = {self.name: [[str(picture) for picture in pictures]]}
        fixed = {key: value for key, value in self.settings.items() if key not in varied}
        options = {"style": style, **fixed, **varied}
        return Entry(
            verb=batch_verbs()[VERB],
            options=options,
            lines=dict.fromkeys(options, 1),
            line=1,
            name=part or f"{self.name}-{'-'.join(picture.stem for picture in pictures)}",
            scenes=((place.name, place),),
            needs=Needs(),
            then=(),
        )


def _spelled(setting: str) -> str:
    return setting.replace("_", "-")


def _listed(values: Sequence[Any]) -> list[Any]:
    """The values as a job file has them, each once."""
    return [list(v) if isinstance(v, tuple) else v for v in dict.fromkeys(values)]

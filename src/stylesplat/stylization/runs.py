"""The objects of a recipe in groups that are painted together, checked before any is painted."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.scene.paintings import Source
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_objects
from stylesplat.stylization.bookkeeping import refuse_painted, strengths
from stylesplat.stylization.paint_objects import check_jobs
from stylesplat.stylization.style import Recipe, StyledObject
from stylesplat.stylization.style_config import Network, Precision
from stylesplat.stylization.style_job import StyleJob
from stylesplat.stylization.undo import unpainted


@dataclass(frozen=True)
class Run:
    """Objects that are painted on the same scene, each by itself, with the same network."""

    objects: tuple[StyledObject, ...]
    """At least one."""
    features: Network
    """Whose features are matched."""
    weights: Source | None
    """The network's file; None for its own."""
    precision: Precision | None
    """In which features are computed; None takes what is fastest."""
    upon: Mapping[str, float]
    """What was painted before, and how strong it is to be meanwhile."""
    unneeded: Set[str] = frozenset()
    """What was painted only for runs before, and goes if it is there."""

    @property
    def names(self) -> set[str]:
        """Of its objects."""
        return {each.name for each in self.objects}

    @property
    def passing(self) -> set[str]:
        """Of those that are there only as long as others are painted upon them."""
        return {each.name for each in self.objects if each.gone}

    def anew(self, scene: Scene) -> set[str]:
        """The names of those that are painted on a scene already."""
        return self.names & strengths(scene).keys()

    def cleared(self, scene: Scene) -> Scene:
        """A scene without what is painted anew, and without what is not needed now."""
        gone = self.anew(scene) | (self.unneeded & strengths(scene).keys())
        return replace(unpainted(scene, gone), path=scene.path)

    def jobs(self, scene: Scene) -> list[StyleJob]:
        """What is to be painted on a scene that is cleared.

        Raises:
            StyleSplatError: If the scene lacks an object, one is too small or part of something
                else that is painted, or a picture is unfit.
        """
        picks = find_objects(scene, [each.name for each in self.objects])
        jobs = [
            StyleJob(each.name, picks[each.name], each.style.read(), each.style.config)
            for each in self.objects
        ]
        check_jobs(jobs)
        refuse_painted(scene, {job.name: job.picked for job in jobs})
        return jobs


def runs_of(
    recipe: Recipe, scene: Scene, features: Network | None, weights: Path | str | None
) -> list[Run]:
    """The objects of a recipe in groups that are painted together, in order.

    Raises:
        StyleSplatError: If the weights are to be those of several networks.
    """
    runs, passing = list[Run](), set[str]()
    for run in _groups(recipe, scene, features, weights):
        runs.append(replace(run, unneeded=passing - run.upon.keys()))
        passing = passing - run.names | run.passing
    return runs


def check_runs(scene: Scene, runs: Sequence[Run]) -> None:
    """Raise before anything is painted what runs would raise, some after many minutes.

    Raises:
        StyleSplatError: As `Run.jobs` does; or if runs share Gaussians.
    """
    known = scene.painted.unsplit if scene.painted else None
    count = known.count if known else len(scene.splats)  # what splits made follows these
    there = dict[str, StyleJob]()
    for run in runs:
        scene = run.cleared(scene)
        there = {name: job for name, job in there.items() if name not in run.names | run.unneeded}
        jobs = [replace(job, picked=job.picked[:count]) for job in run.jobs(scene)]
        check_jobs([*there.values(), *jobs])
        there |= {job.name: job for job in jobs}


def _groups(
    recipe: Recipe, scene: Scene, features: Network | None, weights: Path | str | None
) -> Iterator[Run]:
    upon = strengths(scene)
    run: Run | None = None
    networks = {features or _network(each) for each in recipe.objects}
    if weights and len(networks) > 1:
        raise StyleSplatError(
            f"{weights} is the file of one network, but the recipe has "
            f"{' and '.join(sorted(networks))}. Pass --features too, or write `weights:` into the "
            "recipe's objects."
        )
    for each in recipe.objects:
        network = features or _network(each)
        file = Source(Path(weights)) if weights else each.weights
        if features and features != _network(each) and not weights:
            file = None  # the recipe's is of its own network
        own = Run((each,), network, file, each.precision, _upon(each, upon))
        if run is not None and replace(own, objects=()) == replace(run, objects=()):
            run = replace(run, objects=(*run.objects, each))
            continue
        if run is not None:
            yield run
        run = own
    assert run is not None  # there is at least one object
    yield run


def _network(each: StyledObject) -> Network:
    """The network that an object asks for."""
    return each.features or each.style.network


def _upon(each: StyledObject, there: Mapping[str, float]) -> Mapping[str, float]:
    """What an object is painted upon: what its recipe recorded, besides all that is there."""
    return {**there, **(each.upon or {})}

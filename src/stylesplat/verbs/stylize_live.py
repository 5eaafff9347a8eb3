"""`stylize_live`: repaint one object step by step, to watch it, to stop early or to go on."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from stylesplat.argument_kinds import check_arguments
from stylesplat.rendering.device import pick_device
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.bookkeeping import strengths, with_origin, with_paintings
from stylesplat.stylization.paint_objects import (
    MAX_MEMORY,
    blended,
    moved,
    open_studio,
)
from stylesplat.stylization.repaint import Repainted, repaint
from stylesplat.stylization.runs import Run, check_runs, runs_of
from stylesplat.stylization.style import Style, as_recipe
from stylesplat.stylization.style_config import Network
from stylesplat.stylization.style_job import StyleJob
from stylesplat.stylization.styled_scene import Styled
from stylesplat.verbs.stylize import load_network, records


@dataclass(frozen=True)
class Live:
    """An object that is being painted."""

    state: Repainted
    """How far it is."""
    before: Scene
    """The scene as it was given."""
    ground: Scene
    """What it is painted on: without what it was painted with before."""
    run: Run
    """It alone."""
    job: StyleJob
    """Its Gaussians and settings."""

    @property
    def splats(self) -> Splats:
        """As they look now."""
        return blended(self.state, self.job)

    def scene(self) -> Scene:
        """The scene with what is painted so far, as `stylize` would give it, but not measured."""
        state = self.state
        styled = Styled(self.splats, state.splats, state.base, state.parents)
        painting = records(self.run, [self.job], strengths(self.ground))
        return with_origin(with_paintings(self.ground, styled, painting), self.before)


@check_arguments
def stylize_live(
    scene: Scene,
    name: str,
    style: Style,
    *,
    features: Network | None = None,
    weights: Path | str | None = None,
    max_memory: float = MAX_MEMORY,
    device: str = "auto",
) -> Iterator[Live]:
    """As `stylize` with one object, step by step.

    Args:
        scene: What to paint on.
        name: The object: a name, or a label id.
        style: What it is to look like.
        features: The network whose features are matched; by default that of the preset.
        weights: The network's file.
        max_memory: GiB for prepared views.
        device: Where to compute.

    Yields:
        The state after every step. Whoever stops asking keeps what there is; whoever asks again
        goes on. After the last step its scene is that of `stylize`.

    Raises:
        StyleSplatError: As `stylize` does.

    Example:
        >>> for live in stylize_live(scene, "vase", Style("wave.jpg")):  # doctest: +SKIP
        ...     if live.state.step == 100:
        ...         break
        >>> early = live.scene()  # doctest: +SKIP
    """
    runs = runs_of(as_recipe({name: style}), scene, features, weights)
    check_runs(scene, runs)
    (run,) = runs
    ground = run.cleared(scene)
    (job,) = run.jobs(ground)
    training, held_out = ground.working_views()
    studio = open_studio(
        ground.splats.to(pick_device(device)),
        training,
        load_network([style], run.features, run.weights),
        held_out=held_out,
        max_memory=max_memory,
        precision=run.precision,
    )
    run = replace(run, precision=studio.precision_name)
    job = moved(job, studio.splats)
    for state in repaint(studio, job):
        yield Live(state, scene, ground, run, job)

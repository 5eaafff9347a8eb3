"""`stylize_live`: repaint one object step by step, to watch it, to stop early or to go on."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stylesplat.argument_kinds import check_arguments
from stylesplat.rendering.render import pick_device
from stylesplat.scene.compose import beneath, compose, family
from stylesplat.scene.layer import Layer
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import Network, Precision
from stylesplat.stylization.optimize import PaintState, paint_steps
from stylesplat.stylization.paint import layer_of
from stylesplat.stylization.style import Style, as_recipe
from stylesplat.stylization.target import MAX_MEMORY, PaintTarget, PaintTask, paint_tasks
from stylesplat.verbs.stylize import context_maker, with_layer


@dataclass(frozen=True, eq=False)
class Live:
    """An object that is being painted."""

    state: PaintState
    before: Scene
    """The scene as it was given."""
    beneath: Scene
    """The scene beneath the object's layer."""
    place: int
    """The index of the layer in the stack."""
    task: PaintTask
    target: PaintTarget
    """The object among the Gaussians of `beneath`, and settings."""
    precision: Precision

    @property
    def layer(self) -> Layer:
        """The present layer."""
        rows = family(self.beneath).to(self.state.parents.device)
        return self.task.record(layer_of(self.state, self.target, rows), self.precision)

    @property
    def splats(self) -> Splats:
        """The present look of all Gaussians."""
        layers = self.before.layers
        layers = (*layers[: self.place], self.layer, *layers[self.place + 1 :])
        return compose(self.before.unpainted, layers)

    def scene(self) -> Scene:
        """The scene with the present layer, not measured."""
        return with_layer(self.before, self.place, self.layer)


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
    (task,) = tasks = paint_tasks(as_recipe({name: style}), scene, features, weights)
    under, place = beneath(scene, name)
    context_of = context_maker(scene, tasks, max_memory, pick_device(device))
    context = context_of(under.splats, task)
    target = task.target(family(under)).to(context.splats)
    for state in paint_steps(context, target, preview=True):
        yield Live(state, scene, under, place, task, target, context.precision_name)

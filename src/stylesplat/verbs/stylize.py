"""`stylize`: repaint objects in the style of pictures; `stylize_live`: one, step by step."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.style import measure_painted
from stylesplat.io.layers import read_edit, read_layer_mask
from stylesplat.io.style_pictures import Picture
from stylesplat.options import check_arguments
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.layers import RECOLOR, RELIEF_FORM, Layer, shown_like
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.canvas import PaintState, layer_of
from stylesplat.stylization.config import Network, Precision
from stylesplat.stylization.painter import (
    SurveyedObject,
    check_visible,
    paint_layer,
    paint_steps,
    survey_object,
)
from stylesplat.stylization.painting import (
    MAX_MEMORY,
    Painting,
    plan_paintings,
    setup_maker,
)
from stylesplat.stylization.sculpture import sculpted, with_sculptures
from stylesplat.stylization.style import (
    Recipe,
    RecoloredObject,
    StoredLayer,
    Style,
    StyledObject,
    as_recipe,
)
from stylesplat.stylization.views import ObjectBox
from stylesplat.verbs.adjust import recolor


@check_arguments
def stylize(
    scene: Scene,
    styles: Mapping[str, Style | Picture | Sequence[Picture]] | Recipe,
    *,
    features: Network | None = None,
    weights: Path | str | None = None,
    protect: str | Sequence[str] = (),
    max_memory: float = MAX_MEMORY,
    device: str = "auto",
    on_painted: Callable[[Scene], None] | None = None,
    measured: bool = True,
) -> Scene:
    """Repaint objects of a scene, each in the style of one or more pictures.

    Each object gets a layer of paint, and nothing else changes. A new layer goes on top of the
    stack. The layer of an object that is painted already is replaced, in its place in the stack.
    Objects are painted one after the other, the lowest layer first, each on what the layers beneath
    it show.

    Args:
        scene: What to paint on.
        styles: Pictures or a `Style` by object, which is a name or a label id; or a recipe.
        features: The network whose features are matched; by default what the recipe says, or that
            of the preset: `compact`, which ships with the package, or VGG16 for the paper's.
        weights: The network's file; VGG's are else downloaded, once.
        protect: Names of objects, such as eyes, that get no paint of any of these; in addition to
            those that a style protects. Their Gaussians stay, and no disc of a canvas covers them.
        max_memory: GiB for prepared views; what does not fit takes longer.
        device: Where to compute.
        on_painted: Called with the scene before it is measured, for example to save it.
        measured: Whether to measure the result. If not, its metrics are times and steps only.

    Returns:
        The scene with its layers. Its metrics are `seconds`, `steps`, `precision`, what
        `measure_changes` returns and by object what `measure_style` does; those of training are
        under `train`. `evaluate` measures more.

    Raises:
        StyleSplatError: If an object, picture or weights file is unfit.

    Example:
        >>> stylize(scene, {"vase": "wave.jpg", "pot": Style("night.jpg", scale=2)})
        ... # doctest: +SKIP
    """
    start, before = time.perf_counter(), scene
    recipe = as_recipe(styles)
    if recipe.recolors and not recipe.objects and (features or weights or protect):
        raise StyleSplatError(
            "Nothing is painted: the recipe recolors only, for which --features, --weights and "
            "--protect mean nothing. Leave them out."
        )
    if protect:
        recipe = recipe.protecting((protect,) if isinstance(protect, str) else tuple(protect))
    paintings = plan_paintings(recipe, scene, features, weights)
    setup_on = setup_maker(paintings, scene, max_memory, pick_device(device))
    if len(paintings) > 1:  # so that no object is painted in vain
        for painting in paintings:
            check_visible(*setup_on(scene.below(painting.name), painting))
    shown = {layer.name for layer in scene.layers if layer.is_shown}
    anew = [painting.name for painting in paintings if painting.name in shown]
    if anew:
        say(f"Painting {', '.join(anew)} anew, from the colours before.")
    seconds, precision = dict[str, float](), ""
    entries = {each.name: each for each in recipe.objects}
    surveys = dict[str, Sequence[ObjectBox]]()
    for number, painting in enumerate(paintings):
        scene = _with_edits(scene, recipe, number)
        began = time.perf_counter()
        setup, own = setup_on(scene.below(painting.name), painting)
        layer, surveys[painting.name] = paint_layer(setup, own)
        precision = setup.precision_name
        layer = shown_like(layer.to("cpu"), scene.layer(painting.name), len(scene.base))
        scene = scene.with_layer(_as_in(layer, entries[painting.name], len(scene.base)))
        seconds[painting.name] = time.perf_counter() - began
    scene = _with_edits(scene, recipe, len(paintings))
    strengths = {each.name: each.intensity for each in recipe.objects if each.intensity is not None}
    forms = {each.name: each.form for each in recipe.objects if each.form is not None}
    asked = {*forms, *(each.name for each in paintings)}
    scene = with_sculptures(scene.with_strengths(strengths, forms), asked)
    metrics = {
        "seconds": time.perf_counter() - start,
        "steps": sum(painting.config.all_steps for painting in paintings),
        "precision": precision,
        "seconds_by_object": {each.name: seconds[each.name] for each in recipe.objects},
        "train": before.metrics.get("train", before.metrics),
    }
    scene = replace(scene, metrics=metrics)
    if on_painted is not None:
        on_painted(scene)
    if not (measured and paintings):  # a recipe may hold recolourings alone
        return scene
    unpainted = scene.without_layers(surveys)
    objects = [setup_on(unpainted, painting) for painting in paintings]
    found = measure_painted(objects, scene.splats_with_last(surveys), surveys)
    return replace(scene, metrics=metrics | found)


stylise = stylize


def _with_edits(scene: Scene, recipe: Recipe, place: int) -> Scene:
    """The scene after the recolourings and stored layers that follow so many paintings."""
    return reduce(_recolored, (each for each in recipe.recolors if each.place == place), scene)


def _recolored(scene: Scene, entry: RecoloredObject | StoredLayer) -> Scene:
    """The scene with a recolouring, or a stored layer, of a recipe."""
    count, strength = len(scene.base), entry.strength
    if isinstance(entry, StoredLayer):
        return scene.with_layer(read_edit(entry.path, entry.name, count, strength, entry.blend))
    scene = recolor(scene, entry.name, strength=strength, **entry.config.changed)
    layer = scene.layer(f"{entry.name}{RECOLOR}")
    assert layer is not None  # it was made just now
    return scene.with_layer(_as_in(layer, entry, count))


def _as_in(layer: Layer, entry: StyledObject | RecoloredObject, count: int) -> Layer:
    """A layer on a base of `count` Gaussians with the blend and the mask of a recipe."""
    if entry.blend == "normal" and entry.mask is None:
        return layer
    mask = entry.mask and read_layer_mask(entry.mask, count, layer.kind)[layer.rows]
    return replace(layer, blend=entry.blend, mask=mask)


@dataclass(frozen=True, eq=False)
class Live:
    """An object that is being painted."""

    state: PaintState
    before: Scene
    """The scene as it was given."""
    below: Scene
    """The scene below the object's layer."""
    painting: Painting
    """The object among the Gaussians of `below`."""
    precision: Precision
    survey: SurveyedObject | None = None
    """Of the object, for other paintings of it on the same layers; None with the preset `paper`."""
    finished: Layer | None = None
    """The layer after the last step, if its form takes more than relief."""

    @property
    def layer(self) -> Layer:
        """The present layer."""
        if self.finished is not None:
            return self.finished
        layer = layer_of(self.state, self.painting, self.precision).to("cpu")
        return shown_like(layer, self.before.layer(self.painting.name), len(self.before.base))

    @property
    def splats(self) -> Splats:
        """The present look of all Gaussians."""
        return self.scene().splats

    def scene(self) -> Scene:
        """The scene with the present layer, not measured."""
        return replace(self.before.with_layer(self.layer), composed=self.below.composed)


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
    survey: SurveyedObject | None = None,
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
        survey: That of an earlier `Live` of the object on the same layers, whose first step then
            comes sooner.

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
    (painting,) = paintings = plan_paintings(as_recipe({name: style}), scene, features, weights)
    below = scene.below(name)
    setup_on = setup_maker(paintings, scene, max_memory, pick_device(device))
    setup, painting = setup_on(below, painting)
    if survey is None and not painting.config.published:
        survey = survey_object(setup, painting)
    for state in paint_steps(setup, painting, preview=True, survey=survey):
        live = Live(state, scene, below, painting, setup.precision_name, survey)
        if state.step == state.steps and painting.config.form > RELIEF_FORM:
            live = replace(live, finished=sculpted(below, live.layer))
        yield live

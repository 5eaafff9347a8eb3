"""`stylize`: repaint objects of a scene, each in the style of pictures."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast, get_args

import torch

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.evaluation.stains import largest_stain
from stylesplat.evaluation.style_metrics import measure_painted
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.paintings import Painting, Source
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.bookkeeping import (
    at_intensities,
    strengths,
    with_origin,
    with_paintings,
)
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.paint_objects import MAX_MEMORY, open_studio, paint_objects
from stylesplat.stylization.plain_settings import plain
from stylesplat.stylization.runs import Run, check_runs, runs_of
from stylesplat.stylization.style import (
    Picture,
    Recipe,
    Style,
    StyledObject,
    as_recipe,
    digest,
)
from stylesplat.stylization.style_config import Network
from stylesplat.stylization.style_job import Studio, StyleJob
from stylesplat.stylization.undo import unpainted

ADDED = ("steps", "changed_gaussians", "painted_gaussians", "changed_outside")  # over runs


@dataclass(frozen=True)
class Unmeasured:
    """A painted scene, of which only the times and steps are known yet."""

    scene: Scene
    """As `stylize` returns it, but for the metrics that take measuring."""
    recipe: Recipe
    """What was painted."""
    measures: Sequence[Callable[[], dict[str, Any]]]
    """Of each run, what measures it."""
    device: torch.device
    """Where to render."""

    def measured(self, capture: Capture | None = None) -> Scene:
        """The scene with all of its metrics; see `stylize`."""
        figures = {}
        for measure in self.measures:
            figures = _joined(figures, measure())
        _forget_ways(figures, self.recipe)
        names = sorted({each.name for each in self.recipe.objects if not each.gone})
        if capture is not None and names:
            try:
                before = unpainted(self.scene, names)
                figures |= largest_stain(before, self.scene, names, capture, self.device)
            except StyleSplatError as error:  # the painting is done all the same
                say(f"Stains beside the objects are not looked for: {error}")
        return replace(self.scene, metrics={**self.scene.metrics, **figures})


@check_arguments
def stylize(
    scene: Scene,
    styles: Mapping[str, Style | Picture | Sequence[Picture]] | Recipe,
    *,
    features: Network | None = None,
    weights: Path | str | None = None,
    max_memory: float = MAX_MEMORY,
    device: str = "auto",
    capture: Capture | None = None,
) -> Scene:
    """Repaint objects of a scene, each in the style of one or more pictures.

    Nothing but these objects changes: of their Gaussians the colours, and what a fresh canvas hides
    of them fades, or those too large to show strokes are split. New ones follow all others. Objects
    are painted each by itself; those that were painted before stay to the bit, and show in the
    views that others are painted in. An object that was painted before is painted anew from the
    colours it had before that.

    Args:
        scene: What to paint on.
        styles: Pictures or a `Style` by object, which is a name or a label id; or a recipe.
        features: The network whose features are matched; by default what the recipe says, or that
            of the preset: `compact`, which ships with the package, or VGG16 for the paper's.
        weights: The network's file; VGG's are else downloaded, once.
        max_memory: GiB for prepared views; what does not fit takes longer.
        device: Where to compute.
        capture: The photos of the scene. If they have label maps, the metrics say how large a
            stain there is beside the objects.

    Returns:
        The scene, with what was painted. Its metrics are `seconds`, `steps`, `precision`, what
        changed around the objects, and by object `nnfm_before`, `nnfm_after` and the like; those
        of training are under `train`.

    Raises:
        StyleSplatError: If an object, picture or weights file is unfit, or Gaussians of an object
            are part of another one that is painted.

    Example:
        >>> stylize(scene, {"vase": "wave.jpg", "pot": Style("night.jpg", scale=2)})
        ... # doctest: +SKIP
    """
    rest = {"features": features, "weights": weights, "max_memory": max_memory, "device": device}
    return stylize_unmeasured(scene, styles, **rest).measured(capture)


def stylize_unmeasured(
    scene: Scene,
    styles: Mapping[str, Style | Picture | Sequence[Picture]] | Recipe,
    *,
    features: Network | None = None,
    weights: Path | str | None = None,
    max_memory: float = MAX_MEMORY,
    device: str = "auto",
) -> Unmeasured:
    """As `stylize`, but the scene can be had, and kept, before the painting is measured.

    Raises:
        StyleSplatError: As `stylize` does.
    """
    recipe = as_recipe(styles)
    if not recipe.objects:
        raise StyleSplatError("Nothing to stylise: name at least one object and its style.")
    start = time.perf_counter()
    before, facts, measures = scene, {}, []
    runs = runs_of(recipe, scene, features, weights)
    check_runs(scene, runs)
    for run in runs:
        scene, found, measure = _painted(_cleared(scene, run), run, max_memory, device)
        facts = _joined(facts, found)
        measures.append(measure)
    gone = {name for name, gone in {o.name: o.gone for o in recipe.objects}.items() if gone}
    scene = unpainted(scene, gone & strengths(scene).keys())
    wanted = strengths(before) | {o.name: _final(o) for o in recipe.objects if not o.gone}
    metrics = {"seconds": time.perf_counter() - start, **facts}
    metrics["train"] = before.metrics.get("train", before.metrics)
    scene = replace(with_origin(at_intensities(scene, wanted), before), metrics=metrics)
    return Unmeasured(scene, recipe, measures, pick_device(device))


stylise = stylize


def load_network(
    styles: Sequence[Style],
    features: str,
    weights: Source | None,
    *,
    download: bool = True,
) -> FeatureNetwork:
    """The network that some styles need, as deep as the deepest does.

    Raises:
        StyleSplatError: As `load_weights` does, or if the file is not the one that was meant.
    """
    path = weights.path if weights else None
    if weights and path and weights.sha256 and path.is_file() and digest(path) != weights.sha256:
        raise StyleSplatError(
            f"{path} holds other weights than those that were used: its digest differs. Put the "
            "file back, or pass --weights."
        )
    check_choice(features, "feature network", get_args(Network))
    depth = max(max(style.config.layers) for style in styles)
    return load_weights(cast("Network", features), path, depth=depth, download=download)


def _final(each: StyledObject) -> float:
    """How strong an object is to be in the end."""
    return each.style.config.intensity if each.intensity is None else each.intensity


def _cleared(scene: Scene, run: Run) -> Scene:
    """The scene without what a run paints anew, and without what only others needed."""
    anew = sorted(run.anew(scene))
    if anew:
        say(f"Painting {', '.join(anew)} anew, from the colours before.")
    return run.cleared(scene)


def _forget_ways(measured: Mapping[str, Any], recipe: Recipe) -> None:
    """Say nothing of how close objects come that were measured at another intensity."""
    for each in recipe.objects:
        if not each.gone and _final(each) != each.style.config.intensity:
            for name in ("nnfm_of_style", "share_of_way", "off_palette", "palette_distance"):
                measured.get(name, {}).pop(each.name, None)


def _painted(
    scene: Scene, run: Run, max_memory: float, device: str
) -> tuple[Scene, dict[str, Any], Callable[[], dict[str, Any]]]:
    """The scene after a run, what is known of it and what measures it: not what goes in the end."""
    lost = sorted(run.upon.keys() - strengths(scene).keys() - run.names)
    if lost:
        say(f"{run.objects[0].name} was painted upon {', '.join(lost)}, which is not there now.")
    styles = [each.style for each in run.objects]
    ground = scene
    if scene.painted is not None:  # what it is not painted upon is hidden meanwhile
        ground = at_intensities(scene, dict.fromkeys(strengths(scene), 0.0) | dict(run.upon))
    jobs = run.jobs(ground)
    network = load_network(styles, run.features, run.weights)
    training, held_out = ground.working_views()
    rest = {"held_out": held_out, "max_memory": max_memory, "precision": run.precision}
    opened = partial(open_studio, cameras=training, network=network, **rest)
    studio = opened(ground.splats.to(pick_device(device)))
    run = replace(run, precision=studio.precision_name)
    styled, seconds = paint_objects(studio, jobs)
    scene = with_paintings(ground, styled, records(run, jobs, strengths(ground)))
    staying = [job for job in jobs if job.name not in run.passing]
    if not staying:
        return scene, {}, dict
    facts = {
        "steps": sum(job.config.all_steps for job in staying),
        "precision": studio.precision_name,
        "seconds_by_object": {job.name: seconds[job.name] for job in staying},
    }
    shown = unpainted(scene, run.passing)
    measure = partial(_measured, opened, staying, shown, held_out, studio.splats.device)
    if run.passing:
        return scene, facts, measure
    return scene, facts, partial(measure, cuts=styled.cuts, parents=styled.parents)


def _measured(
    opened: Callable[[Splats], Studio],
    jobs: Sequence[StyleJob],
    scene: Scene,
    held_out: Cameras | None,
    device: torch.device,
    **cut: Any,
) -> dict[str, Any]:
    """What painting some objects did, with one entry per number; `cut` as `measure_painted` has.

    The scene before is made of the one after, which remembers it: two take much memory.
    """
    studio = opened(unpainted(scene, {job.name for job in jobs}).splats.to(device))
    shown = scene.splats.to(device)
    return flat_metrics(measure_painted(studio, jobs, shown, held_out=held_out, **cut))


def records(run: Run, jobs: Sequence[StyleJob], upon: Mapping[str, float]) -> list[Painting]:
    """What a scene remembers of the jobs of a run, and of what was painted before it."""
    weights = run.weights
    if weights is not None and weights.path is not None:
        path = weights.path.resolve()
        weights = Source(path, weights.sha256 or digest(path))
    return [
        Painting(
            name=each.name,
            picked=job.picked.cpu(),  # a job's may lie on a GPU; all of a scene is on the CPU
            styles=each.style.sources(),
            settings=plain(each.style.config),
            intensity=each.style.config.intensity,
            features=run.features,
            weights=weights,
            upon=dict(upon),
            precision=run.precision,
        )
        for each, job in zip(run.objects, jobs, strict=True)
    ]


def flat_metrics(measured: Mapping[str, Any]) -> dict[str, Any]:
    """What was measured with one entry per number, and in it one per object."""
    metrics = {name: value for name, value in measured.items() if name != "objects"}
    for each, numbers in measured["objects"].items():
        for name, value in numbers.items():
            metrics.setdefault(name, {})[each] = value
    return metrics


def _joined(earlier: Mapping[str, Any], later: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of two runs as one: objects together, steps added, else the later ones."""
    joined = {**earlier, **later}
    for name, value in earlier.items():
        if isinstance(value, dict):
            joined[name] = value | later.get(name, {})
        elif name in ADDED:
            joined[name] = value + later.get(name, 0)
    return joined

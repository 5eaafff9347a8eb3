"""`evaluate`: held-out views and styles of a scene in numbers; `compare`: scenes side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, cast

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, noun_repr
from stylesplat.evaluation.changes import largest_stain, measure_changes
from stylesplat.evaluation.photos import evaluate_views, fits_of, measured_rows
from stylesplat.evaluation.style import measure_look, measure_style
from stylesplat.evaluation.summary import metric_differences
from stylesplat.figures.html_page import SceneColumn
from stylesplat.figures.pictures import render_picture
from stylesplat.imaging.similarity import ssim
from stylesplat.options import check_arguments, with_settings
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.frames import with_poses_of
from stylesplat.scene.layers import Layer
from stylesplat.scene.scene import Scene, shared_views
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import Precision, StyleConfig, without_retired
from stylesplat.stylization.painting import Painting, load_network, paint_setup
from stylesplat.stylization.style import Style, digest
from stylesplat.stylization.views import ObjectBox, find_boxes
from stylesplat.training.config import TrainConfig
from stylesplat.training.object_alone import as_trained

EVALUATE_VIEWS = 4  # by default
EVALUATE_VISIBLE = 8  # levels of 255 in a channel: smaller differences are hard to see
EVALUATE_LONGEST = 960  # pixels of a picture's side
COMPARISON = "stylesplat-comparison-1"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Scenes side by side; the first is what others are compared with."""

    views: tuple[str, ...]
    """The photos' names of the pictures."""
    scenes: tuple[SceneColumn, ...]
    """In the order in which they were given."""
    notes: tuple[str, ...] = ()
    """What makes numbers less comparable, in sentences."""

    def __repr__(self) -> str:
        names = ", ".join(each.name for each in self.scenes)
        return noun_repr(self, names, count_noun(len(self.views), "view"))

    def summary(self) -> dict[str, Any]:
        """All but the pictures as plain values, for JSON."""
        fields = ("name", "metrics", "differences", "from_first")
        scenes = [
            {"path": each.scene.path, "gaussians": len(each.scene.splats)}
            | {name: getattr(each, name) for name in fields}
            for each in self.scenes
        ]
        return {"schema": COMPARISON, "views": self.views, "scenes": scenes, "notes": self.notes}


@check_arguments
@torch.no_grad()
def compare(
    scenes: Mapping[str, Scene],
    captures: Mapping[str, Capture] | None = None,
    *,
    views: int = EVALUATE_VIEWS,
    device: str = "auto",
) -> Comparison:
    """Put scenes of the same photos side by side.

    Args:
        scenes: By what they are to be called, at least two; the first is what others are
            compared with. Their world frames may differ.
        captures: The photos of each, as `evaluate` takes them; of those that have none, only a
            style is measured.
        views: How many pictures of each, of views held out in all scenes if there are any.
        device: Where to render.

    Returns:
        Pictures and numbers. What cannot be measured of a scene is said, and noted.

    Raises:
        StyleSplatError: If there are fewer than two scenes, or they share no view.
    """
    if len(scenes) < 2:
        raise StyleSplatError(f"Expected at least two scenes to compare, got {len(scenes)}.")
    names = tuple(evenly_spaced(shared_views(scenes), max(1, views)))
    (first, one), *others = scenes.items()
    notes = [
        f"{name} holds out other photos than {first}: their numbers are of different photos."
        for name, scene in others
        if {*scene.held_out} != {*one.held_out}
    ]
    found = list[SceneColumn]()
    for name, scene in scenes.items():
        metrics: dict[str, Any] = {}
        try:
            metrics = evaluate(scene, (captures or {}).get(name), device=device)
        except StyleSplatError as error:  # pictures of it can be compared
            notes.append(f"{name} has no numbers: {error}")
        if scene.layers and "psnr" in metrics:
            notes.append(f"{name} is painted, and its photos are not: paint counts as error.")
        cameras = scene.cameras[[*map(scene.cameras.names.index, names)]]
        splats = scene.splats.to(pick_device(device))
        small = (camera.at_most(EVALUATE_LONGEST) for camera in cameras)
        pictures = tuple(render_picture(splats, camera) for camera in small)
        base = found[0] if found else None
        differences = metric_differences(metrics, base.metrics if base else metrics)
        from_first = picture_differences(pictures, base.pictures if base else pictures)
        found.append(SceneColumn(name, scene, metrics, differences, from_first, pictures))
    for note in notes:
        say(note)
    return Comparison(names, tuple(found), tuple(notes))


def picture_differences(
    pictures: Sequence[UInt8[Tensor, "_ _ 3"]], first: Sequence[UInt8[Tensor, "_ _ 3"]]
) -> dict[str, float]:
    """Differences of pictures to others of the same views, which are 0 for equal pictures.

    Returns `mean_difference` and `largest_difference` of a channel, in 0..1; `changed_share`, the
    share of pixels of which a channel differs by more than 8 of 255 levels; and `ssim_lost`,
    1 - SSIM. All but the largest are means over the views.
    """
    pairs = [(a.float() / 255, b.float() / 255) for a, b in zip(pictures, first, strict=True)]
    gaps = [(a - b).abs() for a, b in pairs]
    return {
        "mean_difference": fmean(float(gap.mean()) for gap in gaps),
        "largest_difference": max(float(gap.max()) for gap in gaps),
        "changed_share": fmean(
            float((gap.amax(dim=-1) > EVALUATE_VISIBLE / 255).float().mean()) for gap in gaps
        ),
        "ssim_lost": fmean(max(0.0, 1 - float(ssim(a, b))) for a, b in pairs),
    }


EVALUATION = "stylesplat-evaluation-1"  # of what is measured; `compare` has it for each scene


@check_arguments
def evaluate(
    scene: Scene, capture: Capture | None = None, *, device: str = "auto"
) -> dict[str, Any]:
    """Measure a scene.

    Args:
        scene: What to measure.
        capture: The photos that it was made from, at the size to compare at, with the label maps
            to compare with. Without them only a style is measured.
        device: Where to render.

    Returns:
        `schema`; with photos the result of `evaluate_views` for the held-out views; of a painted
        scene those of `measure_style` and `measure_look` by object, as far as its styles and
        networks are at hand, and of `measure_changes`; with label maps also that of
        `largest_stain`.

    Raises:
        StyleSplatError: If there is nothing to measure, or the photos are of another scene.
    """
    splats = scene.splats.to(pick_device(device))
    metrics = {} if capture is None else _photo_metrics(scene, splats, capture)
    if scene.layers:
        metrics |= _styled_metrics(scene, splats)
        if capture is not None:
            before, names = scene.without_layers(), scene.painted_objects
            metrics |= largest_stain(before, scene, names, capture, splats.device)
        return {"schema": EVALUATION} | metrics
    if capture is None:
        raise StyleSplatError("Nothing to compare the scene with. Give the capture of its photos.")
    if not metrics:
        raise StyleSplatError(
            "There are no held-out views to evaluate. Train with `--test-every 8`."
        )
    return {"schema": EVALUATION} | metrics


def _photo_metrics(scene: Scene, splats: Splats, capture: Capture) -> dict[str, Any]:
    """Compare the held-out views with their photos; of an import, some of all views."""
    known = {*scene.cameras.names}
    rows = [row for row, name in enumerate(capture.cameras.names) if name in known]
    if rows and len(rows) < len(capture):  # some were left out when it was trained
        capture = capture.only(rows)
    capture = with_poses_of(capture, scene.cameras)
    capture = as_trained(capture, scene.info)
    if "splat" in scene.info:
        rows = measured_rows(capture)
    else:
        there = {name: row for row, name in enumerate(capture.cameras.names)}
        rows = [there[name] for name in scene.held_out if name in there]
        if scene.held_out and not rows:
            raise StyleSplatError(
                f"None of the {len(scene.held_out)} held-out photos is in {capture.path}, such as "
                f"{scene.held_out[0]}. Put them back."
            )
    fits = fits_of(scene.info.get("fits", ()), capture.cameras)
    background = scene.info.get("settings", {}).get("background", TrainConfig.background)
    return evaluate_views(splats, capture, rows, fits=fits, background=background) if rows else {}


def _styled_metrics(scene: Scene, styled: Splats) -> dict[str, Any]:
    """Measure the painted objects, and what changed around them."""
    base = scene.base.to(styled.device)
    training, held_out = scene.working_views()
    cameras = held_out or training
    picks = {each.object: each.covered(len(base)).to(base.device) for each in scene.layers}
    found = dict[str, dict[str, float]]()
    for layer in scene.layers:
        if layer.kind != "paint":
            continue
        picked = picks[layer.object]
        boxes, views = find_boxes(base, cameras, picked), cameras
        if not boxes and held_out:
            boxes, views = find_boxes(base, training, picked), training
        numbers = _closeness(layer, picked, base, styled, views, boxes)
        numbers |= measure_look(base, styled, views, picked, boxes=boxes)
        for name, value in numbers.items():
            found.setdefault(name, {})[layer.name] = value
    every: Bool[Tensor, " N"] = torch.stack([*picks.values()]).any(dim=0)
    return measure_changes(base, styled, cameras, every) | found


def _closeness(
    layer: Layer,
    picked: Bool[Tensor, " N"],
    base: Splats,
    styled: Splats,
    views: Cameras,
    boxes: Sequence[ObjectBox],
) -> dict[str, float]:
    """Measure how close an object is to its style, if the style and its network are at hand."""
    try:
        style = _style_of(layer)
        network = load_network(
            layer.features, layer.weights, depth=style.config.block, download=False
        )
        painting = Painting(layer.object, picked, style.read(), style.config).to(base)
        setup = paint_setup(base, views, network, precision=cast(Precision | None, layer.precision))
        return measure_style(setup, painting, styled, boxes=boxes)
    except StyleSplatError as error:
        say(f"{layer.object} is not compared with its style: {error}")
        return {}


def _style_of(layer: Layer) -> Style:
    """The style of a layer; refuses pictures that are missing or have changed."""
    pictures = list[Path]()
    for source in layer.styles:
        if source.path is None:
            raise StyleSplatError("its style was never a file.")
        if source.sha256 is not None and digest(source.path) != source.sha256:
            raise StyleSplatError(f"{source.path} is another picture now. Put the one before back.")
        pictures.append(source.path)
    return Style(*pictures, config=with_settings(StyleConfig(), without_retired(layer.settings)))

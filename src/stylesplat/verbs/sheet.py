"""`sheet`: one object in a grid of styles and settings, to choose from."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.drawing.grid import Row, draw_grid
from stylesplat.drawing.object_sheet import close_up
from stylesplat.drawing.pictures import to_uint8
from stylesplat.errors import StyleSplatError
from stylesplat.io.images import write_image
from stylesplat.io.scene_folder import Scene, read_scene
from stylesplat.progress import Task, task
from stylesplat.rendering.device import pick_device
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import blend_colors
from stylesplat.stylization.paint_objects import REPORT_EVERY, check_jobs, moved, open_studio
from stylesplat.stylization.repaint import Repainted, Studio, StyleJob, repaint
from stylesplat.stylization.style_config import DEFAULT_NETWORK, PRESETS, Network, StyleConfig
from stylesplat.stylization.style_images import read_style
from stylesplat.verbs.objects import find_object
from stylesplat.verbs.stylize import load_network, working_views

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")

Styles = tuple[Path, ...]
Variation = tuple[str, tuple[Any, ...]]
Picture = UInt8[Tensor, "_ _ 3"]


class Place(NamedTuple):
    """Where a blend is drawn."""

    row: int
    column: int
    intensity: float


@dataclass(frozen=True)
class PlannedRow:
    """A row of a sheet before it is painted."""

    label: str
    """What its cells have in common."""
    styles: Styles
    """The pictures that make its style."""
    cells: tuple[tuple[str, StyleConfig], ...]
    """Captions and settings."""


@dataclass(frozen=True)
class SheetPlan:
    """What to draw."""

    name: str
    """The object."""
    rows: tuple[PlannedRow, ...]
    """All of the same length."""


def plan_sheet(
    styles: Sequence[tuple[str, Styles]],
    variations: Sequence[Variation],
    *,
    settings: Mapping[str, Any],
) -> SheetPlan:
    """Lay out a sheet: the first variation makes columns, the second or several styles rows.

    Args:
        styles: An object and its pictures; several are alternatives.
        variations: Settings, or `preset`, with the values to try.
        settings: Those that all cells start from, and their `preset`.

    Raises:
        StyleSplatError: If there is more than one object, more than rows and columns can show, or
            a value is out of range.
    """
    names = list(dict.fromkeys(name for name, _ in styles))
    if len(names) != 1:
        got = " and ".join(names) or "none"
        raise StyleSplatError(f"A sheet shows one object, got {got}. Pass --style OBJECT=IMAGE.")
    _refuse_crowded(styles, [key for key, _ in variations])
    columns, downwards = [*_choices(variations[:1])], [*_choices(variations[1:])]
    rows = []
    for _, pictures in styles:
        for label, varied in downwards:
            cells = tuple(
                (caption or "styled", _config({**settings, **varied, **more}))
                for caption, more in columns
            )
            title = label or " + ".join(picture.stem for picture in pictures)
            rows.append(PlannedRow(title, pictures, cells))
    return SheetPlan(names[0], tuple(rows))


def draw_sheet(
    path: Path,
    output: Path,
    plan: SheetPlan,
    *,
    view: str | None = None,
    features: Network = DEFAULT_NETWORK,
    weights: Path | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Repaint an object once for each cell, as `stylize` would, and draw the results.

    Cells that differ in nothing but intensity are blends of one result.

    Args:
        path: The scene, which stays as it is.
        output: The picture to make.
        plan: What to draw.
        view: The photo to look from; by default the one that shows most of the object.
        features: Network whose features are matched.
        weights: File of its weights.
        device: Where to compute.
        overwrite: Whether to replace `output`.

    Returns:
        `sheet`, the `view`, and the numbers of `cells` and of repaintings, `repainted`.

    Raises:
        StyleSplatError: If the object, a picture, the view or the weights file is unfit, or
            `output` is taken or of a format that is not written.
    """
    _refuse_output(output, overwrite=overwrite)
    scene = read_scene(path)
    runs = _runs(plan)
    jobs = _jobs(scene, plan.name, [*runs])
    splats = scene.splats.to(pick_device(device))
    jobs = [moved(job, splats) for job in jobs]
    cameras = scene.cameras if view is None else scene.cameras[scene.cameras.index(view)]
    camera = close_up(splats, cameras, jobs[0].picked)
    network = load_network(jobs, features, weights)
    training, held_out = working_views(scene)
    studio = open_studio(splats, training, network, held_out=held_out)
    pictures = _painted(studio, [*zip(jobs, runs.values(), strict=True)], camera)
    write_image(draw_grid(_captioned(plan, pictures, _picture(splats, camera))), output)
    counts = {"cells": len(pictures), "repainted": len(jobs)}
    return {"sheet": output, "view": camera.names[0], **counts}


def _refuse_crowded(styles: Sequence[Any], keys: Sequence[str]) -> None:
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise StyleSplatError(f"--vary {twice} was given twice. List all its values in one.")
    if len(keys) > (1 if len(styles) > 1 else 2):
        raise StyleSplatError(
            f"Got {len(styles)} styles and --vary {', '.join(keys)}. A sheet has rows and columns: "
            "one style and up to two --vary, or several styles and one."
        )


def _choices(variations: Sequence[Variation]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Captions and settings of the values of one variation; one without any if there is none."""
    if not variations:
        yield "", {}
    for key, values in variations:
        for value in values:
            yield f"{key.replace('_', ' ')} {_shown(value)}", {key: value}


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _config(settings: dict[str, Any]) -> StyleConfig:
    """Settings, on top of the preset among them."""
    changed = {key: value for key, value in settings.items() if key != "preset"}
    return replace(PRESETS[settings["preset"]], **changed)


def _refuse_output(output: Path, *, overwrite: bool) -> None:
    if output.suffix.lower() not in SUFFIXES:
        raise StyleSplatError(f"Cannot draw into {output}: use a name in {', '.join(SUFFIXES)}.")
    if output.is_dir() or (output.exists() and not overwrite):
        raise StyleSplatError(f"{output} exists. Choose another name, or pass --overwrite.")


def _runs(plan: SheetPlan) -> dict[tuple[Styles, StyleConfig], list[Place]]:
    """The cells that each repainting gives, all of which are done at full intensity."""
    runs: dict[tuple[Styles, StyleConfig], list[Place]] = {}
    for number, row in enumerate(plan.rows):
        for column, (_, config) in enumerate(row.cells):
            run = (row.styles, replace(config, intensity=1.0))
            runs.setdefault(run, []).append(Place(number, column, config.intensity))
    return runs


def _jobs(scene: Scene, name: str, runs: Sequence[tuple[Styles, StyleConfig]]) -> list[StyleJob]:
    """What to paint in each run; a picture that several need is in memory once."""
    picked, read = find_object(scene, name), cache(read_style)
    jobs = []
    for styles, config in runs:
        pictures = [read(path, rotate=config.rotate, region=config.region) for path in styles]
        jobs.append(StyleJob(name, picked, tuple(pictures), config))
    check_jobs(jobs[:1])
    return jobs


def _painted(
    studio: Studio, runs: Sequence[tuple[StyleJob, Sequence[Place]]], camera: Cameras
) -> dict[tuple[int, int], Picture]:
    """The picture of each cell, by row and column."""
    pictures = {}
    total = sum(len(places) for _, places in runs)
    with task(runs[0][0].name, total, unit="cell") as bar:
        for job, places in runs:
            state = _repainted(studio, job, bar)
            mask = job.picked[state.parents]
            for place in places:
                splats = blend_colors(state.base, state.splats, mask, place.intensity)
                pictures[place.row, place.column] = _picture(splats, camera)
                bar.advance()
    return pictures


def _repainted(studio: Studio, job: StyleJob, bar: Task) -> Repainted:
    """The last state of a repainting."""
    state = None
    for state in repaint(studio, job):
        if state.step % REPORT_EVERY == 0:
            bar.note(f"step {state.step} of {state.steps}")
    assert state is not None  # there is at least one step
    return state


@torch.no_grad()
def _picture(splats: Splats, camera: Cameras) -> Picture:
    return to_uint8(rasterize(splats, camera)[0][0]).cpu()


def _captioned(
    plan: SheetPlan, pictures: Mapping[tuple[int, int], Picture], before: Picture
) -> list[Row]:
    """The grid's rows, led by the object as it is; style pictures are shown where they change."""
    rows, last = [], None
    for number, row in enumerate(plan.rows):
        first = (before, "before") if number == 0 else None
        cells = [(pictures[number, at], caption) for at, (caption, _) in enumerate(row.cells)]
        new = () if row.styles == last else row.styles
        shown = [to_uint8(read_style(path)) for path in new]
        rows.append(Row([first, *cells], row.label, shown))
        last = row.styles
    return rows

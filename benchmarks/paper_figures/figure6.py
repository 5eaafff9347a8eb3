"""Figure 6: layers, scale of the style, learning rate: what strokes and strength follow."""

from collections.abc import Mapping, Sequence, Sized
from dataclasses import replace
from functools import partial
from itertools import pairwise
from statistics import mean
from typing import Any

import torch
from stroke_length import stroke_length

from paper_figures import figure5
from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure2 import leakage
from paper_figures.painting import few_style_features, painted, paper_config
from paper_figures.story import Block, Figure, Grid, Table, Text, digits
from paper_figures.subject import Subject, shot
from stylesplat.evaluation.style import content_ssim
from stylesplat.figures.best_views import close_up
from stylesplat.stylization.views import find_boxes, typical_length

NAME = "figure6"
GROUPS = {1: "[1,3]", 2: "[6,8]", 3: "[11,13,15]"}  # the paper's indices into VGG16
SCALES = (0.25, 0.5, 0.75)  # of the style picture's own size
RATES = (0.025, 0.05, 0.075)
MIDDLE = (3, 0.5, 0.05)
WITH_MIDDLES = "each with the middle values of the other two"
AXES = {"layers": "group", "scale": "scale", "rate": "rate"}  # and what numbers call them
CLAIM = (
    "a smaller style picture repeats its pattern more often; layers [1,3] cannot learn patterns, "
    "deeper ones act like a smaller style picture; a larger learning rate gives a stronger style."
)

Setting = tuple[int, float, float]
Numbers = Mapping[str, Any]


def cells(subject: Subject) -> list[Cell]:
    """The grid, or the lines through its middle."""
    every = [(g, s, r) for g in GROUPS for s in SCALES for r in RATES]
    if not subject.effort.whole_grid:
        every = [e for e in every if sum(a != b for a, b in zip(e, MIDDLE, strict=True)) <= 1]
    found = [Cell(NAME, _key(setting), partial(_styled, subject, setting)) for setting in every]
    return [Cell(NAME, "initial", partial(_initial, subject)), *found]


def _key(setting: Setting) -> str:
    group, scale, rate = setting
    return f"layers {GROUPS[group]}, scale {scale:g}, rate {rate:g}"


def _initial(subject: Subject) -> Outcome:
    return Outcome({"object": subject.called(subject.ids[0])}, _pictures(subject, subject.splats))


def _pictures(subject: Subject, splats: Any) -> dict[str, Any]:
    """The object from the same place whatever it looks like, in a square."""
    camera = close_up(subject.splats, subject.held_out, subject.picked(subject.ids[0]))
    return {"object": shot(splats, camera)}


@torch.no_grad()
def _measured(subject: Subject, styled: Any, picked: Any) -> dict[str, Any]:
    boxes = find_boxes(subject.splats, subject.held_out, picked)
    return {
        "stroke": stroke_length(subject.splats, styled, picked, boxes),
        "content_ssim": content_ssim(subject.splats, styled, subject.held_out, picked),
        "object_length": typical_length(boxes),
    }


def _styled(subject: Subject, setting: Setting) -> Outcome:
    group, scale, rate = setting
    id, style = subject.ids[0], subject.pattern
    picked = subject.picked(id)
    side = subject.effort.side  # features of [1,3] are as many as pixels
    length = typical_length(find_boxes(subject.splats, subject.training, picked))
    own_scale = scale * max(style.shape[:2]) / length  # in sides of the object, as we count it
    config = replace(paper_config(subject, rate), block=group, scale=own_scale)
    with few_style_features():
        styled = painted(subject, {id: style}, config, side=side).splats
    found = leakage(subject, subject.splats, styled, id)
    numbers = {"group": group, "scale": scale, "rate": rate, "strength": found["strength"]}
    return Outcome(numbers | _measured(subject, styled, picked), _pictures(subject, styled))


def told(results: Results) -> list[Block]:
    """The pictures by layers, scale and rate, the tables, what follows what."""
    found = {key: result for key, result in results.get(NAME, {}).items() if key != "initial"}
    if not found:
        return []
    blocks: list[Block] = [*_grids(results[NAME])]
    heads = ("setting", "stroke, px", "strength (Lab)", "content SSIM")
    rows = [[key, *_digits(result.numbers)] for key, result in found.items()]
    blocks.append(Table(heads, rows))
    lines = {axis: along(results, axis) for axis in AXES}
    blocks.append(Table(("by", *heads[1:]), [row for a in lines.values() for row in _lines(a)]))
    how = "each averaged over the other two" if _whole(found) else WITH_MIDDLES
    blocks += [Text(f"Layers, scale and rate, {how}."), *_fineness(results)]
    trends = (("scale", "stroke"), ("layers", "stroke"), ("rate", "strength"))
    return [*blocks, *(Text(follows(lines[axis], axis, measure)) for axis, measure in trends)]


def _fineness(results: Results) -> list[Text]:
    """How many Gaussians carry the strokes, if Figure 5 says it."""
    initial, counted = results[NAME].get("initial"), results.get(figure5.NAME, {}).get("paper")
    if initial is None or counted is None:
        return []
    count = counted.numbers["gaussians"][initial.numbers["object"]]
    return [
        Text(
            f"The paper's settings do not split the object's {count:,} Gaussians, so no stroke is "
            "finer than a Gaussian."
        )
    ]


def along(results: Results, axis: str) -> dict[str, Numbers]:
    """What is measured by one axis' values: means over the whole grid if that is there."""
    found = {key: result for key, result in results.get(NAME, {}).items() if key != "initial"}
    numbers = [result.numbers for result in found.values()]
    return by_axis(numbers, axis, whole=_whole(found))


def has_whole_grid(results: Results) -> bool:
    """Whether every setting is there, the object as it was aside."""
    return _whole(results.get(NAME, {}).keys() - {"initial"})


def _whole(found: Sized) -> bool:
    return len(found) == len(GROUPS) * len(SCALES) * len(RATES)


def _grids(found: Mapping[str, Any]) -> list[Grid]:
    """A grid for each group of layers, or one of the lines through the middle."""
    layers: dict[str, dict[str, list[Setting]]] = {
        f"Layers {name}: scale across, rate down": {
            f"rate {r:g}": [(group, s, r) for s in SCALES] for r in RATES
        }
        for group, name in GROUPS.items()
    }
    grids = [_grid(found, caption, rows) for caption, rows in layers.items()]
    if all(len(grid.rows) == len(RATES) for grid in grids):
        return grids
    axes = {"layers": [(g, *MIDDLE[1:]) for g in GROUPS]}
    axes |= {"scale": [(MIDDLE[0], s, MIDDLE[2]) for s in SCALES]}
    axes |= {"rate": [(*MIDDLE[:2], r) for r in RATES]}
    lines = _grid(found, f"Layers, scale and rate, {WITH_MIDDLES}", axes)
    return [lines] if lines.rows else []


def _grid(found: Mapping[str, Any], caption: str, rows: Mapping[str, Sequence[Setting]]) -> Grid:
    """Rows that are there in full."""
    there = {label: row for label, row in rows.items() if all(_key(s) in found for s in row)}
    shown = {
        label: {_caption(label, s): found[_key(s)].pictures["object"] for s in row}
        for label, row in there.items()
    }
    return Grid(caption, shown)


def _caption(label: str, setting: Setting) -> str:
    group, scale, rate = setting
    if label == "layers":
        return GROUPS[group]
    return f"rate {rate:g}" if label == "rate" else f"scale {scale:g}"


def by_axis(numbers: Sequence[Numbers], axis: str, *, whole: bool) -> dict[str, Numbers]:
    """What is measured by one axis' values.

    Args:
        numbers: Of each setting.
        axis: Which one.
        whole: Average over the other axes; else keep these in their middle.
    """
    middle = dict(zip(AXES, MIDDLE, strict=True))
    others = {AXES[a]: middle[a] for a in AXES if a != axis}
    if not whole:
        numbers = [n for n in numbers if all(n[name] == value for name, value in others.items())]
    values = sorted({n[AXES[axis]] for n in numbers})
    groups = {value: [n for n in numbers if n[AXES[axis]] == value] for value in values}
    return {
        f"layers {GROUPS[value]}" if axis == "layers" else f"{axis} {value:g}": {
            measure: mean(n[measure] for n in some)
            for measure in ("stroke", "strength", "content_ssim")
        }
        for value, some in groups.items()
    }


def _lines(line: Mapping[str, Numbers]) -> list[list[str]]:
    return [[name, *_digits(numbers)] for name, numbers in line.items()]


def _digits(n: Numbers) -> list[str]:
    return [digits(n["stroke"], 2), digits(n["strength"], 1), digits(n["content_ssim"])]


def follows(line: Mapping[str, Numbers], axis: str, measure: str) -> str:
    """Whether a measure grows along an axis, in a sentence."""
    values = [numbers[measure] for numbers in line.values()]
    shown = ", ".join(digits(value, 2) for value in values)
    what, unit = {"stroke": ("Stroke length", "px"), "strength": ("Strength", "in Lab")}[measure]
    verdict = {1: "grows", -1: "shrinks", 0: "neither grows nor shrinks steadily"}[trend(values)]
    return f"{what} by {axis}: {shown} {unit}; it {verdict}."


def trend(values: Sequence[float]) -> int:
    """1 if values ascend, -1 if they descend, else 0."""
    pairs = [*pairwise(values)]
    if all(a < b for a, b in pairs):
        return 1
    return -1 if all(a > b for a, b in pairs) else 0


FIGURE = Figure(NAME, "Figure 6: scale and intensity", CLAIM, cells, told)

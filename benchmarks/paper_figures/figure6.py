"""Figure 6: layers, scale of the style, learning rate: what strokes and strength follow."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import torch
from strokes import stroke_length

from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure2 import leakage
from paper_figures.painting import painted, paper_config
from paper_figures.story import Block, Figure, Row, Table, Text, digits
from paper_figures.subject import Subject, cut, shot
from stylesplat.evaluation.statistics import content_ssim
from stylesplat.stylization.object_views import find_boxes, typical_length

NAME = "figure6"
GROUPS = {1: "[1,3]", 2: "[6,8]", 3: "[11,13,15]"}  # the paper's indices into VGG16
SCALES = (0.25, 0.5, 0.75)  # of the style picture's own size
RATES = (0.025, 0.05, 0.075)
MIDDLE = (3, 0.5, 0.05)
CLAIM = (
    "a smaller style repeats its pattern more; layers [1,3] cannot learn patterns, deeper ones act "
    "like a smaller style; a larger learning rate gives stronger style."
)

Setting = tuple[int, float, float]


def cells(subject: Subject) -> list[Cell]:
    """The grid, or the lines through its middle."""
    every = [(g, s, r) for g in GROUPS for s in SCALES for r in RATES]
    if not subject.effort.whole_grid:
        every = [e for e in every if sum(a != b for a, b in zip(e, MIDDLE, strict=True)) <= 1]
    return [Cell(NAME, _key(setting), partial(_styled, subject, setting)) for setting in every]


def _key(setting: Setting) -> str:
    group, scale, rate = setting
    return f"layers {GROUPS[group]}, scale {scale:g}, rate {rate:g}"


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
    id, style = subject.ids[0], next(iter(subject.styles.values()))
    picked = subject.picked(id)
    side = subject.effort.side  # features of [1,3] are as many as pixels: full frames take hours
    length = typical_length(find_boxes(subject.splats, subject.training, picked))
    own_scale = scale * max(style.shape[:2]) / length  # in sides of the object, as we count it
    config = replace(paper_config(subject, rate), layers=(group,), scale=own_scale)
    styled = painted(subject, {id: style}, config, side=side).splats
    found = leakage(subject, subject.splats, styled, id)
    numbers = {"group": group, "scale": scale, "rate": rate, "strength": found["strength"]}
    camera = subject.best_view(id)
    mask = subject.true_map(camera) == id
    picture = cut(shot(styled, camera), mask)
    return Outcome(numbers | _measured(subject, styled, picked), {"object": picture})


def told(results: Results) -> list[Block]:
    """Three rows of pictures as the paper has them, the table, what follows what."""
    found = results.get(NAME, {})
    if not found:
        return []
    lines = {
        "layers": [(g, *MIDDLE[1:]) for g in GROUPS],
        "scale": [(MIDDLE[0], s, MIDDLE[2]) for s in SCALES],
        "rate": [(*MIDDLE[:2], r) for r in RATES],
    }
    blocks: list[Block] = []
    for settings in lines.values():
        there = [_key(s) for s in settings if _key(s) in found]
        blocks.append(Row({key: found[key].pictures["object"] for key in there}))
    heads = ("setting", "stroke, px", "strength (Lab)", "content SSIM")
    rows = [
        [key, digits(n["stroke"], 2), digits(n["strength"], 1), digits(n["content_ssim"])]
        for key, n in ((key, result.numbers) for key, result in found.items())
    ]
    blocks.append(Table(heads, rows))
    numbers = {key: result.numbers for key, result in found.items()}
    for line, name in (("scale", "scale"), ("layers", "layer group")):
        blocks.append(Text(_follows(numbers, lines[line], name, "stroke", "Stroke length", "px")))
    blocks.append(Text(_follows(numbers, lines["rate"], "rate", "strength", "Strength", "in Lab")))
    return blocks


def _follows(
    numbers: Mapping[str, Any], settings: Any, name: str, measure: str, what: str, unit: str
) -> str:
    """Whether a measure grows along a line of settings."""
    values = [numbers[_key(s)][measure] for s in settings if _key(s) in numbers]
    shown = ", ".join(digits(value, 2) for value in values)
    pairs = [*pairwise(values)]
    if all(a < b for a, b in pairs):
        verdict = "grows"
    elif all(a > b for a, b in pairs):
        verdict = "shrinks"
    else:
        verdict = "neither grows nor shrinks throughout"
    return f"{what} by {name}: {shown} {unit}; it {verdict}."


FIGURE = Figure(NAME, "Figure 6: scale and intensity", CLAIM, cells, told)

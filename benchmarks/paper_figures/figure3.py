"""Figure 3: from label maps to identities to an object; how right the selection is."""

from collections.abc import Iterator
from functools import partial
from statistics import mean
from typing import Any

import torch
from torch import Tensor

from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure2 import with_errors
from paper_figures.painting import default_config, painted
from paper_figures.story import Block, Figure, Row, Table, Text, digits
from paper_figures.subject import Subject, cut, each, shot
from stylesplat.figures.pictures import label_colors, render_pictures
from stylesplat.imaging.similarity import object_iou
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.selection import THRESHOLD
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import each_object, render_labels
from stylesplat.training.lifting import lift

NAME = "figure3"
THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
CLAIM = (
    "16 numbers per Gaussian, learned from label maps, separate objects; Gaussians below a "
    "threshold (0.95 in its code) and statistical outliers are left out."
)


def cells(subject: Subject) -> list[Cell]:
    """The row of pictures; the label maps that went in; each way to identities."""
    trained = Cell(NAME, "as trained", partial(_selected, subject, lifted=False))
    return [
        Cell(NAME, "pictures", partial(_pictures, subject)),
        Cell(NAME, "label maps", partial(_given, subject)),
        *([trained] if subject.joint else []),
        Cell(NAME, "lifted", partial(_selected, subject, lifted=True)),
    ]


def _pictures(subject: Subject) -> Outcome:
    id = subject.ids[0]
    camera, picked = subject.best_view(id), subject.picked(id)
    mask = subject.true_map(camera) == id
    maps, row = subject.capture.label_maps, subject.capture.cameras.index(camera.names[0])
    labels = None if maps is None else maps[row]
    assert labels is not None

    def drawn(what: str, splats: Splats, **rest: Any) -> Tensor:
        return next(iter(render_pictures(splats, camera, what, **rest)))

    style = next(iter(subject.styles.values()))
    styled = painted(subject, {id: style}, default_config(subject))
    pictures = {
        "photo": subject.capture.photos[row],
        "label map": label_colors(labels),
        "identities": drawn("identities", subject.splats),
        "labels": drawn("label-colors", subject.splats),
        "object": cut(drawn("object", subject.splats, picked=picked), mask),
        "styled": shot(styled.splats, camera),
    }
    return Outcome({"object": subject.called(id), "picked": int(picked.sum())}, pictures)


def _given(subject: Subject) -> Outcome:
    """How right the label maps are that training was given, in the views to judge in."""
    pairs = []
    for camera in each(subject.held_out):
        maps, row = subject.capture.label_maps, subject.capture.cameras.index(camera.names[0])
        labels = None if maps is None else maps[row]
        if labels is not None:
            pairs.append((labels, subject.true_map(camera)))
    return Outcome(_ious(pairs))


def _selected(subject: Subject, *, lifted: bool) -> Outcome:
    splats = subject.splats
    if lifted:
        photos = with_errors(subject, 1.0)
        rows = [photos.cameras.index(name) for name in subject.training.names]
        splats = lift(splats, photos, rows=rows)
    pairs = [(render_labels(splats, c).cpu(), subject.true_map(c)) for c in each(subject.held_out)]
    numbers: dict[str, Any] = {"rendered labels": _ious(pairs)}
    for threshold in THRESHOLDS:
        for kept in (True, False):
            name = f"{threshold:g}, outliers {'kept' if kept else 'removed'}"
            numbers[name] = by_selection(subject, splats, threshold, remove=not kept)
    return Outcome(numbers)


def by_selection(
    subject: Subject, splats: Splats, threshold: float, *, remove: bool
) -> dict[str, float]:
    """Masks of each object as its selected Gaussians cover them, against true ones."""
    found = dict(each_object(splats, subject.ids, threshold=threshold, remove_outliers=remove))
    pairs = []
    for camera in each(subject.held_out):
        truth = subject.true_map(camera)
        for id, picked in found.items():
            pairs.append((id * _seen(splats, camera, picked).long(), truth.where(truth == id, 0)))
    return _ious(pairs)


@torch.no_grad()
def _seen(splats: Splats, camera: Any, picked: Tensor) -> Tensor:
    if not picked.any():
        return torch.zeros(camera.size[::-1], dtype=torch.bool)
    return (coverage(splats, camera, picked) > COVERED).cpu()


def _ious(pairs: list[tuple[Tensor, Tensor]]) -> dict[str, float]:
    both = [object_iou(pairs, boundary=boundary) for boundary in (False, True)]
    for found in both:
        found.pop(BACKGROUND, None)
    return dict(zip(("miou", "boundary_miou"), (mean(f.values()) for f in both), strict=True))


def told(results: Results) -> list[Block]:
    """The pictures, and the table by threshold."""
    found = results.get(NAME, {})
    blocks: list[Block] = []
    if "pictures" in found:
        blocks.append(Row(found["pictures"].pictures))
    ways = [way for way in ("as trained", "lifted") if way in found]
    if ways:
        heads = ["threshold", *(f"{way}, {what}" for way in ways for what in ("mIoU", "boundary"))]
        names = [*found[ways[0]].numbers]
        rows = [[name, *_pairs(found[way].numbers[name] for way in ways)] for name in names]
        if "label maps" in found:
            given = [*_pairs([found["label maps"].numbers])]
            rows.insert(0, ["the given label maps", *given * len(ways)])
        blocks.append(Table(heads, rows))
        blocks += [Text(_best(way, found[way].numbers)) for way in ways]
        speed = results.get("figure7", {}).get("speed")
        if speed is not None and "as trained" in found:
            steps = speed.numbers["train_steps"]
            blocks.append(
                Text(
                    f"The scene was trained for {steps:,} steps (the paper's for 30,000). "
                    "Identities that are learned with the colours become sharper with more steps, "
                    "so another threshold may suit 30,000."
                )
            )
    return blocks


def _pairs(numbers: Any) -> Iterator[str]:
    for each_ in numbers:
        yield from (digits(each_["miou"]), digits(each_["boundary_miou"]))


def _best(way: str, numbers: Any) -> str:
    choices = {name: n for name, n in numbers.items() if "outliers" in name}
    best = max(choices, key=lambda name: choices[name]["miou"])
    paper = f"{0.95:g}, outliers removed"
    ours = f"{THRESHOLD:g}, outliers removed"
    return (
        f"{way.capitalize()}: the best is {best} (mIoU {digits(choices[best]['miou'])}); our "
        f"default, {ours}, has {digits(choices[ours]['miou'])}; the official code's 0.95 has "
        f"{digits(choices[paper]['miou'])}."
    )


FIGURE = Figure(NAME, "Figure 3: selection", CLAIM, cells, told)

"""Learning objects with the colours against lifting label maps afterwards, in equal time.

Each way trains as the scene was trained. Joint training takes a number of steps, every other way as
many as fit into the processor time of those: how long a step takes is measured by short runs of
both, in turn, just before. Lifting has its own time taken off.
"""

import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields, replace
from functools import partial
from time import process_time
from typing import Any
from unittest import mock

import torch
from fox_outlines import FOX, outline_mask

from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure3 import by_selection
from paper_figures.story import Block, Figure, Row, Table, Text, digits
from paper_figures.subject import Subject, cut, each
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.figures.pictures import label_colors
from stylesplat.imaging.similarity import mask_iou
from stylesplat.scene.selection import THRESHOLD
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import render_labels
from stylesplat.training import step
from stylesplat.training.config import TrainConfig
from stylesplat.training.lifting import lift
from stylesplat.training.loop import fit
from stylesplat.training.state import State
from stylesplat.training.views import split_views

NAME = "segmenting"
PACE_STEPS, PACE_REFINE = 30, 3  # schedules follow the run, so a short one has the same mix
ROUNDS = 2  # of short runs in turn
ANIMAL = 1  # label id of what is outlined by hand
CLAIM = (
    "identities are learned along with the colours, with a term that keeps neighbours in 3D "
    "together; in Gaussian Grouping's code their gradients also reach the geometry."
)


@dataclass(frozen=True)
class Way:
    """How Gaussians come to their objects."""

    lifted: bool = False
    """By lifting the label maps once colours are trained."""
    neighbours: bool = True
    """Whether the term in 3D is on."""
    geometry: bool = False
    """Whether the identity loss moves and reshapes Gaussians."""

    def switched(self) -> AbstractContextManager[Any]:
        """Training without the 3D term, which has no setting: of no scene so many are asked."""
        off = mock.patch.object(step, "NEIGHBORS", sys.maxsize)
        return nullcontext() if self.neighbours else off


JOINT, WITHOUT, LIFTED = "joint", "joint, without the 3D term", "lifted"
WAYS = {
    JOINT: Way(),
    WITHOUT: Way(neighbours=False),
    "joint, gradients to geometry": Way(geometry=True),
    LIFTED: Way(lifted=True),
}


def cells(subject: Subject) -> list[Cell]:
    """A training each."""
    return [Cell(NAME, name, partial(_measured, subject, way)) for name, way in WAYS.items()]


def as_trained(subject: Subject) -> TrainConfig:
    """The scene's own settings; colour correction is off, for held-out photos have none."""
    known, names = subject.scene.info["settings"], {field.name for field in fields(TrainConfig)}
    own = TrainConfig(**{name: value for name, value in known.items() if name in names})
    steps = subject.effort.training_steps or subject.scene.metrics["steps"]
    return replace(own, steps=steps, max_seconds=None, color_correction="off")


def fitted(subject: Subject, way: Way, config: TrainConfig) -> tuple[Splats, float, float]:
    """Gaussians with objects, and the processor seconds of training and of lifting."""
    photos, marks = subject.capture, []

    def mark(_state: State, _loss: float, _psnr: float) -> None:
        marks.append(process_time())

    config = replace(config, identity_geometry=way.geometry)
    learned = replace(photos, label_maps=None) if way.lifted else photos
    with way.switched():
        splats = fit(learned, config, on_progress=mark).splats.detach()
    training = (marks[-1] - marks[0]) * config.steps / (config.steps - 1)  # the first is warm-up
    start = process_time()
    if way.lifted:
        splats = lift(splats, photos, rows=split_views(photos, config.test_every)[0])
    return splats, training, process_time() - start


def affordable(subject: Subject, way: Way, config: TrainConfig) -> int:
    """How many steps this way takes in the processor time of the joint way's."""
    short = replace(config, steps=PACE_STEPS, refine_every=PACE_REFINE)
    joint, own, lifting = 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        joint += fitted(subject, Way(), short)[1]
        _, training, after = fitted(subject, way, short)
        own, lifting = own + training, lifting + after
    return round((config.steps * joint - PACE_STEPS * lifting) / own)


def _measured(subject: Subject, way: Way) -> Outcome:
    config = as_trained(subject)
    if way != Way():
        config = replace(config, steps=affordable(subject, way, config))
    splats, training, lifting = fitted(subject, way, config)
    truth = subject.truth
    rows = [truth.cameras.index(name) for name in subject.held_out.names]
    found = evaluate_views(splats, truth, rows)
    numbers: dict[str, Any] = {name: found[name] for name in ("psnr", "miou", "boundary_miou")}
    numbers |= {"steps": config.steps, "training": training, "lifting": lifting}
    numbers["picked"] = by_selection(subject, splats, THRESHOLD, remove=True)
    numbers["by_hand"] = _by_hand(subject, splats)
    camera = subject.best_view(subject.ids[0])
    shown = label_colors(render_labels(splats, camera))
    return Outcome(numbers, {"labels": cut(shown, subject.true_map(camera) == subject.ids[0])})


@torch.no_grad()
def _by_hand(subject: Subject, splats: Splats) -> float | None:
    """The fox against its outlines, in all photos that have one; None in other scenes."""
    every = subject.training + subject.held_out
    if subject.capture.path is None or subject.capture.path.name != "fox":
        return None
    seen = [camera for camera in each(every) if camera.names[0] in FOX]
    masks = [outline_mask(camera.names[0], camera.size) for camera in seen]
    found = [render_labels(splats, camera) == ANIMAL for camera in seen]
    ious = [mask_iou(*pair) for pair in zip(found, masks, strict=True)]
    return sum(ious) / len(ious) if ious else None


def told(results: Results) -> list[Block]:
    """Labels side by side, the table, what it says."""
    found = results.get(NAME, {})
    if not found:
        return []
    heads = ["way", "steps", "processor seconds", "held-out PSNR", "mIoU", "boundary"]
    heads += ["mIoU of selections", "their boundary", "fox by hand"]
    rows = [_row(name, result.numbers) for name, result in found.items()]
    if not any(row[-1] for row in rows):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    pictures = {name: result.pictures["labels"] for name, result in found.items()}
    blocks: list[Block] = [Row(pictures), Table(heads, rows)]
    both = [found[name].numbers for name in (LIFTED, JOINT) if name in found]
    if JOINT in found:
        steps = found[JOINT].numbers["steps"]
        line = f"{steps:,} steps of joint training are few beside the paper's 30,000. "
        blocks.append(Text(line + "We did not measure how far it is behind after 30,000."))
    return [*blocks, Text(_verdict(*both))] if len(both) > 1 else blocks


def _row(name: str, n: Any) -> list[str]:
    return [
        name,
        f"{n['steps']:,}",
        f"{n['training'] + n['lifting']:.0f}",
        f"{n['psnr']:.2f} dB",
        *(digits(n[key]) for key in ("miou", "boundary_miou")),
        *(digits(n["picked"][key]) for key in ("miou", "boundary_miou")),
        digits(n["by_hand"]),
    ]


def _verdict(lifted: Any, joint: Any) -> str:
    """By how much lifting is ahead."""
    gains = [lifted[key] - joint[key] for key in ("psnr", "miou", "boundary_miou")]
    gains.append(lifted["picked"]["miou"] - joint["picked"]["miou"])
    line = "In equal time, lifting differs from joint training by {:+.2f} dB, {:+.3f} in mIoU, "
    return f"{line}{{:+.3f}} along boundaries and {{:+.3f}} in the selections' mIoU.".format(*gains)


FIGURE = Figure(NAME, "Identities: learned or lifted", CLAIM, cells, told)

"""The official code's faults, one at a time, in the loop of Figure 2 over the object's Gaussians.

That code masks the loss with the 2D label maps as they are given. It squashes the style to the
frame's size with its sides exchanged (here the same length is kept, so that only proportions
change), averages NNFM over the black background too, and resizes label ids bicubically, which
makes other ids of those at contours. The formula that the paper prints, which its code does not
follow, lacks "1 -": it is minimised by the features that are least like the style's.
"""

from functools import partial
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure2 import Task, leakage, trained_colours, with_errors
from paper_figures.painting import paper_config
from paper_figures.story import Block, Figure, Row, Table, digits
from paper_figures.subject import Subject, cut, each, shot
from stylesplat.evaluation.changes import farther_than
from stylesplat.evaluation.style import content_ssim, measure_style
from stylesplat.imaging.similarity import mask_iou
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, Labels, Mask, resize_labels
from stylesplat.scene.splats import Splats
from stylesplat.stylization.painter import paint_setup
from stylesplat.stylization.painting import Painting

NAME = "official"
SQUASHED, BLACK, BICUBIC = "style squashed", "black background counts", "bicubic labels"
FAULTS = {
    "none": (),
    SQUASHED: (SQUASHED,),
    BLACK: (BLACK,),
    BICUBIC: (BICUBIC,),
    "all three": (SQUASHED, BLACK, BICUBIC),
}
PRINTED = "the formula as printed"
RIM = 3.0  # pixels inside the object's contour
CLAIM = "label maps mask its loss; it does not mention what else its code does."


def cells(subject: Subject) -> list[Cell]:
    """Without faults, with each, with all; and with the formula as it is printed."""
    every = {**FAULTS, PRINTED: (PRINTED,)}
    return [Cell(NAME, key, partial(_styled, subject, faults)) for key, faults in every.items()]


def _styled(subject: Subject, faults: tuple[str, ...]) -> Outcome:
    id = subject.ids[0]
    picked, style = subject.picked(id), next(iter(subject.styles.values()))
    mask_of = partial(_mask, with_errors(subject, 1.0), id, bicubic=BICUBIC in faults)
    if SQUASHED in faults:
        style = squashed(style, subject.training[0].size)
    task = Task(mask_of, picked, black=BLACK in faults, style=style, printed=PRINTED in faults)
    styled = trained_colours(subject, subject.splats, task)
    numbers: dict[str, Any] = leakage(subject, subject.splats, styled, id)
    numbers["content_ssim"] = content_ssim(subject.splats, styled, subject.held_out, picked)
    numbers["nnfm"] = _closeness(subject, styled)
    camera = subject.best_view(id)
    mask = subject.true_map(camera) == id
    before, after = shot(subject.splats, camera), shot(styled, camera)
    rim = mask & ~farther_than(~mask, RIM)
    numbers["rim"], numbers["inner"] = (
        float((after - before)[where].mean()) for where in (rim, mask & ~rim)
    )
    numbers["mask_iou"] = _mask_iou(subject, mask_of, id)
    return Outcome(numbers, {"object": cut(after, mask)})


def _closeness(subject: Subject, styled: Splats) -> float:
    """NNFM of the object as it is now with the style as it is, in held-out views."""
    id, style = subject.ids[0], next(iter(subject.styles.values()))
    job = Painting(subject.called(id), subject.picked(id), (style,), paper_config(subject))
    studio = paint_setup(subject.splats, subject.held_out, subject.network)
    return measure_style(studio, job, styled)["nnfm_after"]


def squashed(style: Tensor, size: tuple[int, int]) -> Tensor:
    """A picture in the proportions of a frame of this width and height with sides exchanged."""
    exchanged = F.interpolate(style.permute(2, 0, 1)[None], size, mode="bilinear")
    return exchanged[0].permute(1, 2, 0)


def bicubic_labels(labels: Labels, size: tuple[int, int]) -> Labels:
    """A label map at this width and height, its ids taken for brightnesses."""
    values = cv2.resize(labels.numpy().astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    return torch.from_numpy(np.rint(values)).to(labels)


def _mask(photos: Capture, id: int, camera: Cameras, *, bicubic: bool) -> Mask | None:
    labels = photos.labels(photos.cameras.index(camera.names[0]))
    if labels is None:
        return None
    if bicubic:
        return bicubic_labels(labels, camera.size) == id
    return resize_labels(labels, camera.size[::-1]) == id


def _mask_iou(subject: Subject, mask_of: Any, id: int) -> float:
    """Of the masks of the loss with true ones, over the training views."""
    pairs = [
        (mask_of(camera), subject.true_map(camera) == id)
        for camera in each(subject.training.at_most(subject.effort.side))
    ]
    ious = [mask_iou(*pair) for pair in pairs if pair[0] is not None]
    return sum(ious) / len(ious)


def told(results: Results) -> list[Block]:
    """Pictures and numbers by fault."""
    found = results.get(NAME, {})
    if not found:
        return []
    heads = ["fault", "masks, IoU", "changed inside", "strength (Lab)", "content SSIM", "NNFM"]
    heads += ["brighter by, inside", f"within {RIM:g} px of the contour"]
    names = ("mask_iou", "changed_inside", "strength", "content_ssim", "nnfm", "inner", "rim")
    rows = [[key, *(digits(result.numbers[n]) for n in names)] for key, result in found.items()]
    pictures = {key: result.pictures["object"] for key, result in found.items()}
    return [Row(pictures), Table(heads, rows)]


FIGURE = Figure(NAME, "The official code's faults", CLAIM, cells, told)

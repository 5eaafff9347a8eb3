"""What a phrase means in a scene: boxes that a detector draws in some views vote for objects."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import track
from stylesplat.rendering.one_view import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.pasted import pasted
from stylesplat.scene.sampling import far_apart
from stylesplat.scene.splats import Splats
from stylesplat.selection.detector import MIN_SCORE, Detections, Detector
from stylesplat.selection.identities import render_labels
from stylesplat.selection.pick import SCENE

VIEWS = 8  # that are looked at: a view in which the detector errs is outvoted
LONGER_SIDE = 1024  # pixels of a view; detectors shrink larger ones
STRAYS = 0.01  # of an object's pixels at each side that may lie apart, out of its box
MIN_FIT = 0.3  # IoU below which a box is around something else, or something without a label
# Votes that may be chance: a quarter of the views must show a box that just counts, or fewer a
# box that is surer than that
CHANCE = MIN_SCORE / 4
RIVAL = 0.8  # of the best score, from which on the second best may be meant as well


def rank_objects(
    splats: Splats,
    cameras: Cameras,
    phrase: str,
    detector: Detector,
) -> dict[int, float]:
    """How well a phrase fits each object, over views from all around.

    The detector sees renders, not photos: they are at hand for every scene, imported ones and
    those whose capture is gone too, and show exactly the pixels that the label map is of.

    Args:
        splats: Gaussians with identities, in the colours they had before styling.
        cameras: Views to choose from.
        phrase: What to find, in a few words.
        detector: Finds it in single pictures.

    Returns:
        Scores from 0 to 1 by label id, the best first; objects that no box fits are left out.

    Raises:
        StyleSplatError: If the splats have no identities, or the phrase is too long to be read.
    """

    def looked_at() -> Iterator[tuple[Int[Tensor, "H W"], Detections]]:
        for row in track(far_apart(cameras, VIEWS), "looking for it"):
            camera = cameras[row].at_most(LONGER_SIDE)
            labels = render_labels(splats, camera).cpu()
            yield labels, detector.detect(_picture(splats, camera), phrase)

    return tally(looked_at())


def tally(views: Iterable[tuple[Int[Tensor, "_ _"], Detections]]) -> dict[int, float]:
    """Count the votes of boxes for objects.

    Each box votes, with its score, for the object whose own box in the label map it fits best,
    if it fits: by intersection over union, so that a large object in the background does not win
    for filling the box. Boxes of one view around one object are one vote, that of the best.

    Args:
        views: Label maps, 0 for background, and what was found in the same view.

    Returns:
        Votes over the number of views, by label id, the best first.
    """
    from torchvision.ops import box_iou  # loads for seconds, and few select by text

    votes: dict[int, float] = {}
    count = 0
    for labels, found in views:
        count += 1
        ids, boxes = _object_boxes(labels)
        if not ids or not len(found.boxes):
            continue
        best: dict[int, float] = {}
        fits, columns = box_iou(_clipped(found.boxes, labels), boxes).max(dim=1)
        for fit, column, score in zip(fits, columns, found.scores, strict=True):
            if fit >= MIN_FIT:
                id = ids[int(column)]
                best[id] = max(best.get(id, 0.0), float(score))
        for id, score in best.items():
            votes[id] = votes.get(id, 0.0) + score
    ranking = sorted(votes, key=lambda id: (-votes[id], id))
    return {id: votes[id] / count for id in ranking}


def clear_winner(
    scores: Mapping[int, float],
    phrase: str,
    names: Mapping[int, str] | None = None,
    *,
    folder: Path | None = None,
) -> int:
    """The object that a phrase means.

    Args:
        scores: Votes by id.
        phrase: What was looked for.
        names: What objects are called, by id.
        folder: The scene's, for messages.

    Raises:
        StyleSplatError: If none fits, or only by chance, or the second best nearly as well as the
            best.
    """
    if not scores:
        raise StyleSplatError(
            f"No object of the scene fits {phrase!r}. Try another phrase, or run "
            f"`{pasted('objects', folder or SCENE)}` and select with --id."
        )
    best, *rest = sorted(scores, key=lambda id: -scores[id])
    called = {id: f" {name!r}" for id, name in (names or {}).items()}
    candidates = ", ".join(f"{id}{called.get(id, '')} ({scores[id]:.2f})" for id in (best, *rest))
    if scores[best] < CHANCE:
        raise StyleSplatError(
            f"Hardly any view shows what fits {phrase!r}. By id, with scores: {candidates}. Select "
            "with --id, or try another phrase."
        )
    if rest and scores[rest[0]] >= RIVAL * scores[best]:
        raise StyleSplatError(
            f"{phrase!r} may mean several objects. By id, with scores: {candidates}. Select with "
            "--id, or try another phrase."
        )
    return best


def _picture(splats: Splats, camera: Cameras) -> UInt8[Tensor, "H W 3"]:
    image, _ = render(splats, camera)
    return (255 * image.clamp(0, 1)).round().to(torch.uint8).cpu()


def _object_boxes(labels: Int[Tensor, "H W"]) -> tuple[list[int], Float[Tensor, "M 4"]]:
    """The box around each object of a label map, without strays."""
    ids = [id for id in labels.unique().tolist() if id != BACKGROUND]
    inner = torch.tensor([STRAYS, 1 - STRAYS])
    boxes = []
    for id in ids:
        places = (labels == id).nonzero().float()
        (top, left), (bottom, right) = places.quantile(inner, dim=0)
        boxes.append(torch.stack([left, top, right + 1, bottom + 1]))
    return ids, torch.stack(boxes) if boxes else torch.zeros(0, 4)


def _clipped(boxes: Float[Tensor, "B 4"], labels: Int[Tensor, "H W"]) -> Float[Tensor, "B 4"]:
    """The parts of boxes that are in the picture."""
    height, width = labels.shape
    return boxes.clamp(min=0).minimum(boxes.new_tensor([width, height, width, height]))

"""Selection by text: boxes that a detector finds in some views vote for objects."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.io.hub import find_model, load_model, load_processor
from stylesplat.progress import track
from stylesplat.rendering.render import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.sequences import farthest_views
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import UNKNOWN_SCENE, render_labels

CHECKPOINT = "IDEA-Research/grounding-dino-tiny"
GROUNDED = ("grounding-dino", "mm-grounding-dino")  # score every word of a text for every box
CONCEPTS = ("sam3", "sam3_video")  # take one phrase
MIN_SCORE = 0.3  # below it detectors guess; both kinds have about this default


class NoMatch(StyleSplatError):
    """No object fits the words, or several do."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes in a picture: left, top, right, bottom in pixels, and scores from 0 to 1."""

    boxes: Float[Tensor, "B 4"]
    scores: Float[Tensor, " B"]


@runtime_checkable
class Detector(Protocol):
    """Finds a phrase in a picture."""

    def detect(self, picture: UInt8[Tensor, "H W 3"], phrase: str) -> Detections:
        """Boxes on the CPU."""
        ...


@dataclass(frozen=True)
class PhraseDetector:
    """A detector of `transformers`: Grounding DINO (Liu et al. 2024) or SAM 3."""

    model: Any
    processor: Any
    grounded: bool
    """Whether the model scores words (see `GROUNDED`)."""
    min_score: float = MIN_SCORE

    @torch.no_grad()
    def detect(self, picture: UInt8[Tensor, "H W 3"], phrase: str) -> Detections:
        """The boxes of a phrase, on the CPU; refuses a phrase that is too long for the model."""
        text = f"{phrase.rstrip('.')}." if self.grounded else phrase  # trained on whole sentences
        inputs = self.processor(
            images=picture.cpu().numpy(),
            text=text,
            input_data_format="channels_last",
            return_tensors="pt",
        ).to(self.model.device)
        length, config = inputs["input_ids"].shape[1], self.model.config
        limit = config.text_config.max_position_embeddings
        options = {"threshold": self.min_score, "target_sizes": [tuple(picture.shape[:2])]}
        if self.grounded:
            limit = min(limit, config.max_text_len)
            options["input_ids"] = inputs["input_ids"]
            post_process = self.processor.post_process_grounded_object_detection
        else:
            post_process = self.processor.post_process_object_detection
        if length > limit:
            raise StyleSplatError(
                f"The phrase {phrase[:20]!r}... takes {length} tokens, the model reads {limit}. "
                "Use fewer words."
            )
        (found,) = post_process(self.model(**inputs), **options)
        return Detections(found["boxes"].float().cpu(), found["scores"].float().cpu())


def load_detector(model: str | None = None, device: torch.device | str = "cpu") -> PhraseDetector:
    """Load a Grounding DINO (by default the smallest) or SAM 3, by folder or hub name."""
    source = find_model(model or CHECKPOINT, [*GROUNDED, *CONCEPTS], job="find objects by a phrase")
    from transformers import (
        AutoModelForZeroShotObjectDetection,
        AutoProcessor,
        Sam3Model,
        Sam3Processor,
    )

    grounded = source.model_type in GROUNDED
    # In a `sam3_video` other models are found first
    kind = AutoModelForZeroShotObjectDetection if grounded else Sam3Model
    processor = load_processor(source, AutoProcessor if grounded else Sam3Processor)
    loaded = load_model(source, kind, device=device, dtype=torch.float32)
    return PhraseDetector(loaded, processor, grounded=grounded)


TEXT_VIEWS = 8  # rendered: the others outvote a view in which the detector errs
TEXT_LONGER_SIDE = 1024  # pixels of a view; detectors shrink larger ones
STRAYS = 0.01  # share of an object's pixels at each side that its box leaves out
MIN_FIT = 0.3  # IoU below which a box is around something else, or something without a label
# Score that may be chance: a quarter of the views must have a box that just counts, or fewer
# views a box of a higher score
CHANCE = MIN_SCORE / 4
RIVAL = 0.8  # share of the best score from which the second best is ambiguous


def rank_objects(
    splats: Splats,
    cameras: Cameras,
    phrase: str,
    detector: Detector,
) -> dict[int, float]:
    """Scores from 0 to 1 of how well a phrase fits objects, by label id, the best first.

    The detector looks at renders from all around, not at photos, as every scene has them and they
    agree with the rendered label map. Objects that no box fits are left out.
    """

    def detections() -> Iterator[tuple[Int[Tensor, "H W"], Detections]]:
        for row in track(farthest_views(cameras, TEXT_VIEWS), "looking for it"):
            camera = cameras[row].at_most(TEXT_LONGER_SIDE)
            labels = render_labels(splats, camera).cpu()
            yield labels, detector.detect(_picture(splats, camera), phrase)

    return count_votes(detections())


def count_votes(views: Iterable[tuple[Int[Tensor, "_ _"], Detections]]) -> dict[int, float]:
    """Mean scores of objects over views of label maps and detections, the best first.

    A box counts for the object whose box in the label map it fits best by intersection over union,
    so that a large object in the background does not win by filling the box. Of several boxes in
    one view around one object the best counts.
    """
    from torchvision.ops import box_iou  # loads for seconds, and few select by text

    votes, count = Counter[int](), 0
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
        votes.update(best)  # adds the scores
    return {id: vote / count for id, vote in sorted(votes.items(), key=lambda v: (-v[1], v[0]))}


def clear_winner(
    scores: Mapping[int, float],
    phrase: str,
    names: Mapping[int, str] | None = None,
    *,
    folder: Path | None = None,
) -> int:
    """The object with clearly the best score; names by label id and the folder are for messages."""
    if not scores:
        raise NoMatch(
            f"No object of the scene fits {phrase!r}. Try another phrase, or run "
            f"`{shell_command('objects', folder or UNKNOWN_SCENE)}` and select with --id."
        )
    best, *rest = sorted(scores, key=lambda id: -scores[id])
    called = {id: f" {name!r}" for id, name in (names or {}).items()}
    candidates = ", ".join(f"{id}{called.get(id, '')} ({scores[id]:.2f})" for id in (best, *rest))
    if scores[best] < CHANCE:
        raise NoMatch(
            f"Hardly any view shows what fits {phrase!r}. By id, with scores: {candidates}. Select "
            "with --id, or try another phrase."
        )
    if rest and scores[rest[0]] >= RIVAL * scores[best]:
        raise NoMatch(
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

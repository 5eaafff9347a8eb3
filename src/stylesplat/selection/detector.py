"""Where in a picture a phrase shows: open-vocabulary detectors."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.models.hub import find_model, load_model, load_processor

CHECKPOINT = "IDEA-Research/grounding-dino-tiny"
GROUNDED = ("grounding-dino", "mm-grounding-dino")  # score every word of a text for every box
CONCEPTS = ("sam3", "sam3_video")  # find what one phrase means
MIN_SCORE = 0.3  # below it detectors guess; both kinds' own default is about that


@dataclass(frozen=True)
class Detections:
    """Boxes in a picture."""

    boxes: Float[Tensor, "B 4"]
    """Left, top, right and bottom in pixels."""
    scores: Float[Tensor, " B"]
    """How sure the detector is of each, from 0 to 1."""


@runtime_checkable
class Detector(Protocol):
    """Finds what a phrase means."""

    def detect(self, picture: UInt8[Tensor, "H W 3"], phrase: str) -> Detections:
        """The boxes around it, on the CPU."""
        ...


@dataclass(frozen=True)
class PhraseDetector:
    """A detector of `transformers`: Grounding DINO (Liu et al. 2024) or SAM 3."""

    model: Any
    """Takes a picture and words, and gives boxes."""
    processor: Any
    """Makes the model's input, and pixels of its output."""
    grounded: bool
    """Whether it is of the kind that scores words."""
    min_score: float = MIN_SCORE
    """The score above which a box counts."""

    @torch.no_grad()
    def detect(self, picture: UInt8[Tensor, "H W 3"], phrase: str) -> Detections:
        """The boxes around what a phrase means, on the CPU.

        Raises:
            StyleSplatError: If the phrase is longer than the model reads.
        """
        text = f"{phrase.rstrip('.')}." if self.grounded else phrase  # trained on whole sentences
        inputs = self.processor(
            images=picture.cpu().numpy(),
            text=text,
            input_data_format="channels_last",
            return_tensors="pt",
        ).to(self.model.device)
        self._check_length(phrase, inputs["input_ids"].shape[1])
        post_process = (
            self.processor.post_process_grounded_object_detection
            if self.grounded
            else self.processor.post_process_object_detection
        )
        given = {"threshold": self.min_score, "target_sizes": [tuple(picture.shape[:2])]}
        if self.grounded:
            given["input_ids"] = inputs["input_ids"]
        (found,) = post_process(self.model(**inputs), **given)
        return Detections(found["boxes"].float().cpu(), found["scores"].float().cpu())

    def _check_length(self, phrase: str, length: int) -> None:
        limit = self.model.config.text_config.max_position_embeddings
        if self.grounded:
            limit = min(limit, self.model.config.max_text_len)
        if length > limit:
            raise StyleSplatError(
                f"The phrase {phrase[:20]!r}... takes {length} tokens, the model reads {limit}. "
                "Use fewer words."
            )


def load_detector(model: str | None = None, device: torch.device | str = "cpu") -> PhraseDetector:
    """Load a model that finds things by words.

    Args:
        model: Folder or name of a Grounding DINO or SAM 3; by default the smallest of the former.
        device: Where to compute.

    Raises:
        StyleSplatError: If the model cannot be found, downloaded or loaded, or is another.
    """
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

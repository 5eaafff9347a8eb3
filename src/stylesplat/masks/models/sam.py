"""The models of the SAM family: which there are, and how each is loaded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.masks.models.follow import MemoryFollower
from stylesplat.masks.models.propose import GridProposer
from stylesplat.models.hub import find_model, load_model, load_processor
from stylesplat.scene.labels import Mask

Method = Literal["sam", "sam2", "edgetam", "sam3"]


@runtime_checkable
class Proposer(Protocol):
    """Finds objects in one photo."""

    def propose(self, photo: UInt8[Tensor, "H W 3"]) -> list[Mask]:
        """Masks of what may be objects or parts of them, best first; they may overlap."""
        ...


@runtime_checkable
class Follower(Protocol):
    """Finds objects of one photo again in others."""

    def follow(
        self, photos: Sequence[UInt8[Tensor, "H W 3"]], seeds: Mapping[int, Mask]
    ) -> list[dict[int, Mask]]:
        """The masks by object of every photo, given those of the first."""
        ...


@dataclass(frozen=True)
class Family:
    """Models that share their weights: one for photos, one for sequences of photos."""

    checkpoint: str
    """The one that is taken unless the user names another: small, or the only one."""
    min_iou: float
    """The quality above which its authors keep a proposed mask; each model rates itself."""
    proposer_types: tuple[str, ...]
    """`model_type`s of checkpoints that hold the model for photos."""
    follower_types: tuple[str, ...] = ()
    """`model_type`s of checkpoints that hold the model for sequences; none if there is none."""
    follower: str = ""
    """Its class in `transformers`."""
    follower_processor: str = ""
    """The class that prepares its input."""


FAMILIES: dict[Method, Family] = {
    "sam": Family("facebook/sam-vit-base", 0.88, ("sam",)),
    "sam2": Family(
        "facebook/sam2.1-hiera-tiny",
        0.8,
        ("sam2", "sam2_video"),
        ("sam2_video",),
        "Sam2VideoModel",
        "Sam2VideoProcessor",
    ),
    "edgetam": Family(
        "yonigozlan/EdgeTAM-hf",
        0.8,
        ("edgetam", "edgetam_video"),
        ("edgetam_video",),
        "EdgeTamVideoModel",
        "Sam2VideoProcessor",
    ),
    # `facebook/sam3` is a `sam3_video`: a detector of words and this tracker, which takes masks
    "sam3": Family(
        "facebook/sam3",
        0.8,
        ("sam3_tracker", "sam3_video"),
        ("sam3_tracker_video", "sam3_video"),
        "Sam3TrackerVideoModel",
        "Sam3TrackerVideoProcessor",
    ),
}


def load_proposer(
    method: Method, model: str | None = None, device: torch.device | str = "cpu"
) -> GridProposer:
    """Load a model that proposes masks. `dataclasses.replace` changes its thresholds.

    Args:
        method: The family.
        model: Folder or name of a checkpoint of it; by default a small one.
        device: Where to compute.

    Raises:
        StyleSplatError: If the model cannot be found, downloaded or loaded, or is another.
    """
    family = FAMILIES[method]
    name = model or family.checkpoint
    source = find_model(name, family.proposer_types, job=f"propose masks with {method}")
    from transformers import AutoImageProcessor, AutoModelForMaskGeneration

    return GridProposer(
        load_model(source, AutoModelForMaskGeneration, device=device, dtype=_dtype(device)),
        load_processor(source, AutoImageProcessor),
        min_iou=family.min_iou,
    )


def load_follower(
    method: Method, model: str | None = None, device: torch.device | str = "cpu"
) -> MemoryFollower:
    """Load a model that follows objects through photos.

    Args:
        method: The family; `sam` has none.
        model: Folder or name of a checkpoint of it; by default a small one.
        device: Where to compute.

    Raises:
        StyleSplatError: If the family has none, or the model cannot be found, downloaded or
            loaded, or is another.
    """
    family = FAMILIES[method]
    if not family.follower_types:
        others = [name for name, each in FAMILIES.items() if each.follower_types]
        raise StyleSplatError(
            f"{method} knows single photos only and cannot follow objects from one to the next. "
            f"Use {' or '.join(others)}."
        )
    name = model or family.checkpoint
    source = find_model(name, family.follower_types, job=f"follow objects with {method}")
    import transformers

    kind = getattr(transformers, family.follower)
    processor = getattr(transformers, family.follower_processor)
    return MemoryFollower(
        load_model(source, kind, device=device, dtype=_dtype(device)),
        load_processor(source, processor),
    )


def _dtype(device: torch.device | str) -> torch.dtype:
    """What the models compute in: the format they were trained in, where it is fast."""
    return torch.bfloat16 if torch.device(device).type == "cuda" else torch.float32

"""The SAM family: which models exist, how they are loaded, and masks of all objects in a photo."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from stylesplat.io.hub import ModelFolder, find_model, load_model, load_processor
from stylesplat.masks.tracking import VideoPropagator
from stylesplat.scene.capture import Mask

SamMethod = Literal["sam", "sam2", "edgetam", "sam3"]

# Pixels of enlarged masks that are in memory together: 64 MB as float32. 64 points at once with 3
# masks each would be 3 GB for 4 megapixels
SAM_PIXELS_AT_ONCE = 2**24
CPU_POINTS = 16  # a side, as a decoder takes a tenth of a second for each point on a core
AMPERE = (8, 0)  # compute capability
STABLE_WITHIN = 1.0  # logits around 0 between which the border of a stable mask hardly moves


@dataclass(frozen=True)
class SamFamily:
    """Models that share their weights: one for photos, one for sequences of photos."""

    checkpoint: str
    """The default checkpoint: small, or the only one."""
    core_seconds: float
    """What it takes a CPU to find the masks of a photo, at `CPU_POINTS` a side."""
    proposer_types: tuple[str, ...]
    """`model_type`s of checkpoints that hold the model for photos."""
    video_types: tuple[str, ...] = ()
    """`model_type`s of checkpoints that hold the model for sequences, if there is one."""
    video_model: str = ""
    """Its class in `transformers`."""
    video_processor: str = ""


FAMILIES: dict[SamMethod, SamFamily] = {
    "sam": SamFamily("facebook/sam-vit-base", 35.0, ("sam",)),
    "sam2": SamFamily(
        "facebook/sam2.1-hiera-tiny",
        30.0,
        ("sam2", "sam2_video"),
        ("sam2_video",),
        "Sam2VideoModel",
        "Sam2VideoProcessor",
    ),
    "edgetam": SamFamily(
        "yonigozlan/EdgeTAM-hf",
        29.0,
        ("edgetam", "edgetam_video"),
        ("edgetam_video",),
        "EdgeTamVideoModel",
        "Sam2VideoProcessor",
    ),
    # `facebook/sam3` is a `sam3_video`: a detector of words and this tracker, which takes masks
    "sam3": SamFamily(
        "facebook/sam3",
        110.0,
        ("sam3_tracker", "sam3_video"),
        ("sam3_tracker_video", "sam3_video"),
        "Sam3TrackerVideoModel",
        "Sam3TrackerVideoProcessor",
    ),
}


def find_proposer(method: SamMethod, model: str | None = None) -> ModelFolder:
    """Find a model that proposes masks, or download it; see `load_proposer`."""
    family = FAMILIES[method]
    name = model or family.checkpoint
    return find_model(name, family.proposer_types, job=f"propose masks with {method}")


def load_proposer(
    method: SamMethod, model: str | None = None, device: torch.device | str = "cpu"
) -> "GridProposer":
    """Load a model that proposes masks; `model` is the folder or name of a checkpoint."""
    source = find_proposer(method, model)
    from transformers import AutoImageProcessor, AutoModelForMaskGeneration

    proposer = GridProposer(
        load_model(source, AutoModelForMaskGeneration, device=device, dtype=_dtype(method, device)),
        load_processor(source, AutoImageProcessor),
    )
    on_cpu = torch.device(device).type == "cpu"
    return replace(proposer, points_per_side=CPU_POINTS) if on_cpu else proposer


def load_propagator(
    method: SamMethod, model: str | None = None, device: torch.device | str = "cpu"
) -> VideoPropagator:
    """Load a model that follows objects through photos; `sam` has none. See `load_proposer`."""
    family = FAMILIES[method]
    name = model or family.checkpoint
    source = find_model(name, family.video_types, job=f"follow objects with {method}")
    import transformers

    kind = getattr(transformers, family.video_model)
    return VideoPropagator(
        load_model(source, kind, device=device, dtype=_dtype(method, device)),
        load_processor(source, getattr(transformers, family.video_processor)),
    )


def _dtype(method: SamMethod, device: torch.device | str) -> torch.dtype:
    """The format that most models were trained in, where it is fast: on GPUs from Ampere on."""
    place = torch.device(device)
    if method == "sam3" or place.type != "cuda" or torch.cuda.get_device_capability(place) < AMPERE:
        return torch.float32
    return torch.bfloat16


@dataclass(frozen=True)
class GridProposer:
    """A model of the SAM family that is asked about a grid of points.

    The filters are those of the authors' automatic mask generator (Kirillov et al. 2023), but for
    `min_iou` and without crops of the photo.
    """

    model: Any
    processor: Any
    """Makes the model's input of photos, and masks of the photo's size of its output."""
    min_iou: float = 0.7
    """The quality, as the model rates it, above which masks are kept; that of Gaussian Grouping,
    which keeps more than the authors' .8 and .88."""
    min_stability: float = 0.95
    """The share of a mask that must not depend on the exact threshold."""
    max_overlap: float = 0.7
    """IoU of two masks' boxes above which the worse is a duplicate of the better."""
    points_per_side: int = 32
    points_at_once: int = 32
    """In one pass: the decoder of SAM 2 takes 35 MB for each."""

    @torch.no_grad()
    def propose(self, photo: UInt8[Tensor, "H W 3"]) -> list[Mask]:
        """Masks of what may be objects or parts of them, best first; they may overlap."""
        from torchvision.ops import nms  # of `stylesplat[segment]`; loads for seconds

        inputs = self.processor(
            images=photo.cpu().numpy(), input_data_format="channels_last", return_tensors="pt"
        )
        pixels = inputs["pixel_values"].to(self.model.device, self.model.dtype)
        sizes = {key: value.tolist() for key, value in inputs.items() if key.endswith("_sizes")}
        height, width = sizes.get("reshaped_input_sizes", [pixels.shape[-2:]])[0]
        steps = (torch.arange(self.points_per_side) + 0.5) / self.points_per_side
        points = torch.cartesian_prod(steps, steps).flip(1) * torch.tensor([width, height])
        found = list(self._stable(self._good(pixels, points), sizes))
        if not found:
            return []
        logits, qualities, boxes = (torch.cat(each) for each in zip(*found, strict=True))
        best = nms(boxes, qualities, self.max_overlap)
        return [
            mask.to(photo.device)
            for some in self._enlarged(logits[best], sizes)
            for mask in some > 0
        ]

    def _good(
        self, pixels: Float[Tensor, "1 3 h w"], points: Float[Tensor, "P 2"]
    ) -> Iterator[tuple[Float[Tensor, "M u v"], Float[Tensor, " M"]]]:
        """Small masks at the points that the model rates well, and their qualities."""
        embeddings = self.model.get_image_embeddings(pixels)
        for some in points.split(self.points_at_once):
            # [1, P, 1, 2]: one photo, one point a mask; bfloat16 would round to 4 pixels
            asked = some.to(pixels.device)[None, :, None]
            output = self.model(
                image_embeddings=embeddings,
                input_points=asked,
                input_labels=torch.ones_like(asked[..., 0], dtype=torch.int64),
            )
            qualities = output.iou_scores[0].flatten().float()
            good = qualities > self.min_iou
            yield output.pred_masks[0].flatten(0, 1)[good].float(), qualities[good]

    def _stable(
        self,
        masks: Iterator[tuple[Float[Tensor, "M u v"], Float[Tensor, " M"]]],
        sizes: dict[str, list],
    ) -> Iterator[tuple[Float[Tensor, "M u v"], Float[Tensor, " M"], Float[Tensor, "M 4"]]]:
        """Those whose border is certain, with their boxes in the photo.

        Masks stay small until duplicates are removed, since a thousand of them may be left.
        """
        from torchvision.ops import masks_to_boxes

        for logits, qualities in masks:
            start = 0
            for large in self._enlarged(logits, sizes):
                stability = _area(large > STABLE_WITHIN) / _area(large > -STABLE_WITHIN)
                inside = large > 0
                keep = (stability >= self.min_stability) & inside.any(dim=2).any(dim=1)
                rows = slice(start, start := start + len(large))
                yield logits[rows][keep], qualities[rows][keep], masks_to_boxes(inside[keep])

    def _enlarged(
        self, logits: Float[Tensor, "M u v"], sizes: dict[str, list]
    ) -> Iterator[Float[Tensor, "_ H W"]]:
        """The masks at the photo's size, some at a time."""
        ((height, width),) = sizes["original_sizes"]
        for some in logits.split(max(1, SAM_PIXELS_AT_ONCE // (height * width))):
            resized = self.processor.post_process_masks([some[:, None]], binarize=False, **sizes)
            yield resized[0][:, 0]


def _area(masks: Bool[Tensor, "M H W"]) -> Float[Tensor, " M"]:
    return masks.flatten(1).sum(dim=1).float()

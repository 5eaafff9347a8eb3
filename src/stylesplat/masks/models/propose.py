"""Masks of whatever there is in one photo: a grid of points is asked what lies there."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torchvision.ops import masks_to_boxes, nms

from stylesplat.scene.labels import Mask

# Of masks at the photo's size that are in memory together: 64 MB as float32, be it 16 small
# masks or one of a large photo. 64 points at once with 3 masks each would be 3 GB for 4 MP.
PIXELS_AT_ONCE = 2**24
STABLE_WITHIN = 1.0  # logits around 0 between which the border of a stable mask hardly moves


@dataclass(frozen=True)
class GridProposer:
    """A model of the SAM family that is asked about a grid of points.

    The filters are those of the authors' automatic mask generator (Kirillov et al. 2023), without
    crops of the photo.
    """

    model: Any
    """Takes points and gives masks with their quality."""
    processor: Any
    """Makes the model's input of photos, and masks of the photo's size of its output."""
    min_iou: float = 0.88
    """The quality, as the model rates it, above which masks are kept."""
    min_stability: float = 0.95
    """The share of a mask that must not depend on the exact threshold."""
    max_overlap: float = 0.7
    """IoU of two masks' boxes above which the worse is taken for a copy of the better."""
    points_per_side: int = 32
    """Of the grid."""
    points_at_once: int = 32
    """Asked in one pass: the decoder of SAM 2 takes 35 MB for each."""

    @torch.no_grad()
    def propose(self, photo: UInt8[Tensor, "H W 3"]) -> list[Mask]:
        """Masks of what may be objects or parts of them.

        Returns:
            Masks on the photo's device, best first; they may overlap.
        """
        inputs = self.processor(
            images=photo.cpu().numpy(), input_data_format="channels_last", return_tensors="pt"
        )
        pixels = inputs["pixel_values"].to(self.model.device, self.model.dtype)
        sizes = {key: value.tolist() for key, value in inputs.items() if key.endswith("_sizes")}
        height, width = sizes.get("reshaped_input_sizes", [pixels.shape[-2:]])[0]
        points = _grid(self.points_per_side) * torch.tensor([width, height])
        found = list(self._stable(self._asked(pixels, points), sizes))
        if not found:
            return []
        logits, qualities, boxes = (torch.cat(each) for each in zip(*found, strict=True))
        best = nms(boxes, qualities, self.max_overlap)
        return [
            mask.to(photo.device)
            for some in self._resized(logits[best], sizes)
            for mask in some > 0
        ]

    def _asked(
        self, pixels: Float[Tensor, "1 3 h w"], points: Float[Tensor, "P 2"]
    ) -> Iterator[tuple[Float[Tensor, "M u v"], Float[Tensor, " M"]]]:
        """Small masks at the points, those that the model finds good, and how good."""
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
        asked: Iterator[tuple[Float[Tensor, "M u v"], Float[Tensor, " M"]]],
        sizes: dict[str, list],
    ) -> Iterator[tuple[Float[Tensor, "M u v"], Float[Tensor, " M"], Float[Tensor, "M 4"]]]:
        """Those whose border is certain, with their boxes in the photo.

        Masks stay small until copies are sorted out, since a thousand of them may be left.
        """
        for logits, qualities in asked:
            start = 0
            for large in self._resized(logits, sizes):
                stability = _area(large > STABLE_WITHIN) / _area(large > -STABLE_WITHIN)
                shown = large > 0
                keep = (stability >= self.min_stability) & shown.any(dim=2).any(dim=1)
                rows = slice(start, start := start + len(large))
                boxes = masks_to_boxes(shown[keep])
                yield logits[rows][keep], qualities[rows][keep], boxes

    def _resized(
        self, logits: Float[Tensor, "M u v"], sizes: dict[str, list]
    ) -> Iterator[Float[Tensor, "_ H W"]]:
        """The masks at the photo's size, some at a time."""
        ((height, width),) = sizes["original_sizes"]
        for some in logits.split(max(1, PIXELS_AT_ONCE // (height * width))):
            resized = self.processor.post_process_masks([some[:, None]], binarize=False, **sizes)
            yield resized[0][:, 0]


def _grid(count: int) -> Float[Tensor, "P 2"]:
    """The middles of the cells of a square grid, x and y from 0 to 1, row by row."""
    steps = (torch.arange(count) + 0.5) / count
    return torch.cartesian_prod(steps, steps).flip(1)


def _area(masks: Bool[Tensor, "M H W"]) -> Float[Tensor, " M"]:
    return masks.flatten(1).sum(dim=1).float()

"""Masks of objects in one photo, propagated into other photos: by a video model, or by a splat."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional as F

from stylesplat.masks.tracking import labels_to_masks, masks_to_labels
from stylesplat.rendering.shares import PRIOR, label_votes, largest_shown, scaled_rows
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND, Mask
from stylesplat.scene.splats import Splats

MIN_CERTAINTY = 0.3  # share of a pixel that an object must have in the render of a splat


@dataclass(frozen=True)
class VideoPropagator:
    """A model of the SAM family that remembers objects from photo to photo (Ravi et al. 2024)."""

    model: Any
    processor: Any

    @torch.no_grad()
    def propagate(
        self, photos: Sequence[UInt8[Tensor, "H W 3"]], seeds: Mapping[int, Mask]
    ) -> list[dict[int, Mask]]:
        """Find the objects whose masks in the first photo are `seeds`, by id, in all photos.

        Returns:
            Masks by id for each photo, on the seeds' device. The first photo's are the seeds.
            Later masks do not overlap: pixels go to the object with the highest logit. Objects
            that a photo does not show are left out.
        """
        seeds = {id: mask for id, mask in seeds.items() if mask.any()}
        if not seeds or len(photos) < 2:
            return [dict(seeds) for _ in photos]
        size, device = next((mask.shape, mask.device) for mask in seeds.values())
        session = self._open_session(photos, seeds)
        found = [seeds]
        for row in range(len(photos)):
            output = self.model(session, frame_idx=row)
            if row:
                logits, presence = output.pred_masks, output.object_score_logits.flatten()
                masks = split_by_logit(logits[:, 0], presence, size)
                found.append({output.object_ids[at]: mask.to(device) for at, mask in masks.items()})
            _drop_masks(session, row)
        return found

    def _open_session(
        self, photos: Sequence[UInt8[Tensor, "H W 3"]], seeds: Mapping[int, Mask]
    ) -> Any:
        session = self.processor.init_video_session(
            inference_device=self.model.device, dtype=self.model.dtype
        )
        inputs = self.processor.image_processor(
            images=[photo.cpu().numpy() for photo in photos],
            input_data_format="channels_last",
            return_tensors="pt",
        )
        pixels = inputs["pixel_values"].to(self.model.device, self.model.dtype)
        session.processed_frames = dict(enumerate(pixels))
        self.processor.add_inputs_to_inference_session(
            session, frame_idx=0, obj_ids=[*seeds], input_masks=[*seeds.values()]
        )
        return session


def split_by_logit(
    logits: Float[Tensor, "M h w"], presence: Float[Tensor, " M"], size: Sequence[int]
) -> dict[int, Mask]:
    """The masks of the objects that are present, by row; each pixel is of one of them at most.

    They are enlarged one by one, since there may be a hundred.
    """
    best = torch.zeros(*size, device=logits.device)  # what is not above 0 is no object
    owner = torch.full_like(best, -1, dtype=torch.int64)
    for row in (presence >= 0).nonzero().flatten().tolist():
        small = logits[row][None, None].float()
        large = F.interpolate(small, tuple(size), mode="bilinear", align_corners=False)[0, 0]
        higher = large > best
        best, owner = torch.where(higher, large, best), torch.where(higher, row, owner)
    return {row: owner == row for row in owner.unique().tolist() if row >= 0}


def _drop_masks(session: Any, row: int) -> None:
    """Drop the masks at the model's size, which it never reads again: 4 MB an object and photo."""
    for outputs in session.output_dict_per_obj.values():
        for memories in outputs.values():
            for name in ("high_res_masks", "pred_masks"):
                memories.get(row, {}).pop(name, None)


@torch.no_grad()
def propagate_through_splat(
    splats: Splats, cameras: Cameras, rows: Sequence[int], seeds: Mapping[int, Mask]
) -> list[dict[int, Mask]]:
    """Propagate masks of the first of some photos by lifting them onto the Gaussians there.

    Returns masks by id for each photo; those of the first are the seeds, which do not overlap.
    """
    if not seeds:
        return [{} for _ in rows]
    labels = masks_to_labels(seeds, next(iter(seeds.values())).shape)
    ids, votes = label_votes(splats, cameras, [(rows[0], labels)])
    shares = scaled_rows(votes, 1 / (votes.sum(axis=1) + PRIOR))
    known, found = torch.tensor(ids), [dict(seeds)]
    for row in rows[1:]:
        certainty, column = largest_shown(splats, cameras[row], shares)
        labels = torch.where(certainty > MIN_CERTAINTY, known[column], BACKGROUND)
        found.append(labels_to_masks(labels))
    return found

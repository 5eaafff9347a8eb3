"""Objects that are marked in one photo, found again in those that follow it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.cache import Lazy
from stylesplat.scene.labels import Mask


@dataclass(frozen=True)
class MemoryFollower:
    """A model of the SAM family that remembers objects from photo to photo (Ravi et al. 2024)."""

    model: Any
    """Finds objects in one photo after the other, with the help of a session."""
    processor: Any
    """Makes the model's input of photos and masks, and opens sessions."""

    @torch.no_grad()
    def follow(
        self, photos: Sequence[UInt8[Tensor, "H W 3"]], seeds: Mapping[int, Mask]
    ) -> list[dict[int, Mask]]:
        """Find the objects of the first photo in all of them.

        Args:
            photos: Of one size, neighbours showing much of the same. Each is asked for once.
            seeds: The objects' masks in the first photo, by id.

        Returns:
            Masks by id for each photo, on the seeds' device. The first photo's are the seeds.
            Later masks do not overlap: pixels go to the object that is surest of them. Objects
            that a photo does not show are left out.
        """
        seeds = {id: mask for id, mask in seeds.items() if mask.any()}
        if not seeds or len(photos) < 2:
            return [dict(seeds) for _ in photos]
        session = self._session(photos, seeds)
        found = [seeds]
        for row in range(len(photos)):
            output = self.model(session, frame_idx=row)
            if row:
                logits, presence = output.pred_masks, output.object_score_logits.flatten()
                shown = _part(logits[:, 0], presence, next(iter(seeds.values())).shape)
                ids = output.object_ids
                found.append({ids[at]: mask for at, mask in shown.items()})
            _forget(session, row, self.model.config)
        device = next(iter(seeds.values())).device
        return [{id: mask.to(device) for id, mask in masks.items()} for masks in found]

    def _session(self, photos: Sequence[UInt8[Tensor, "H W 3"]], seeds: Mapping[int, Mask]) -> Any:
        """What the model knows of these photos, to begin with: the seeds."""
        session = self.processor.init_video_session(
            inference_device=self.model.device, dtype=self.model.dtype
        )
        # Prepared when they are their turn, and then kept no longer: 12 MB each
        prepare = [partial(self._pixels, photos, row) for row in range(len(photos))]
        session.processed_frames = Lazy(prepare)
        self.processor.add_inputs_to_inference_session(
            session, frame_idx=0, obj_ids=[*seeds], input_masks=[*seeds.values()]
        )
        return session

    def _pixels(self, photos: Sequence[UInt8[Tensor, "H W 3"]], row: int) -> Float[Tensor, "3 h w"]:
        inputs = self.processor.image_processor(
            images=photos[row].cpu().numpy(),
            input_data_format="channels_last",
            return_tensors="pt",
        )
        return inputs["pixel_values"][0].to(self.model.device, self.model.dtype)


def _part(
    logits: Float[Tensor, "M h w"], presence: Float[Tensor, " M"], size: Sequence[int]
) -> dict[int, Mask]:
    """The masks of the objects that are there, by row, each pixel to one of them at most.

    They are enlarged one by one, since there may be a hundred.
    """
    best = torch.zeros(*size, device=logits.device)  # what is not above 0 is no object
    owner = torch.full_like(best, -1, dtype=torch.int64)
    for row in (presence >= 0).nonzero().flatten().tolist():
        small = logits[row][None, None].float()
        large = F.interpolate(small, tuple(size), mode="bilinear", align_corners=False)[0, 0]
        surer = large > best
        best, owner = torch.where(surer, large, best), torch.where(surer, row, owner)
    return {row: owner == row for row in owner.unique().tolist() if row >= 0}


def _forget(session: Any, row: int, config: Any) -> None:
    """Drop what the model never looks at again: 4 MB for each object and photo.

    A session keeps every mask at the model's size, which is used within the step only, and all
    memories, of which the model recalls the first photo's and the latest.
    """
    recalled = max(config.num_maskmem, config.max_object_pointers_in_encoder)
    for outputs in session.output_dict_per_obj.values():
        for memories in outputs.values():
            for name in ("high_res_masks", "pred_masks"):
                memories.get(row, {}).pop(name, None)
        outputs["non_cond_frame_outputs"].pop(row - recalled, None)

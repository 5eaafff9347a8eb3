"""Label maps of a capture from a segmenter of single photos: detect, confirm, propagate, associate.

The decoupled scheme of DEVA (Cheng et al. 2023): what a segmenter finds in single photos is a
hypothesis; neighbouring photos confirm it; what is confirmed takes on the ids that are known.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Float, UInt8
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist
from torch import Tensor
from torch.nn import functional as F

from stylesplat.imaging.similarity import pairwise_iou
from stylesplat.masks.repair import SMALLEST_PART
from stylesplat.rendering.weights import PRIOR, label_pixels, render_argmax
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Labels, Mask
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

        Masks are on the seeds' device. Later ones do not overlap: pixels go to the object with the
        highest logit. Objects that a photo does not show are left out.
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
    """The masks of the objects that are present, by row; each pixel is of one of them at most."""
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


def propagate_through_splat(
    splats: Splats, cameras: Cameras, rows: Sequence[int], seeds: Mapping[int, Mask]
) -> list[dict[int, Mask]]:
    """Propagate masks of the first photo, which do not overlap, by lifting them there."""
    if not seeds:
        return [{} for _ in rows]
    labels = masks_to_labels(seeds, next(iter(seeds.values())).shape)
    maps = lift_and_render(splats, cameras, {rows[0]: labels}, rows[1:])
    return [dict(seeds), *map(labels_to_masks, maps)]


def lift_and_render(
    splats: Splats, cameras: Cameras, maps: Mapping[int, Labels], rows: Sequence[int]
) -> Iterator[Labels]:
    """The labels that Gaussians have by the label maps of some photos, in other photos."""
    ids, pixels = label_pixels(splats, cameras, maps.items())
    shares = csr_array(pixels.multiply(1 / (pixels.sum(axis=1) + PRIOR)[:, None]))
    known = torch.tensor(ids, dtype=torch.int32)
    for row in rows:
        certainty, column = render_argmax(splats, cameras[row], shares)
        yield torch.where(certainty > MIN_CERTAINTY, known[column], BACKGROUND)


CLIP = 5  # photos from one keyframe, where objects are detected, to the next
TRACK_WINDOW = 3  # photos that vote on what a keyframe shows: itself and those after it
CONFIRMATIONS = 2  # photos that must agree on an object
TRACK_PATIENCE = 3  # keyframes in a row in which an object may be missed before it is dropped
OTHER_SIZE = 10.0  # distance of photos of another size; the cameras' mean distance is 1
TRACK_SAME_IOU = 0.5  # of two masks of one object in one photo
MIN_FREE = 0.5  # share of a mask that no better one may cover
TRACK_LARGEST = 0.8  # of a photo: a larger mask is background; a close-up fills half of one


@dataclass(frozen=True, eq=False)
class Segmenter:
    """Finds objects in photos, which it knows by their rows."""

    size: Callable[[int], tuple[int, int]]
    """Height and width of a photo."""
    propose: Callable[[int], Sequence[Mask]]
    """Masks of what may be objects in a photo; they may overlap."""
    propagate: Callable[[Sequence[int], Mapping[int, Mask]], Sequence[Mapping[int, Mask]]]
    """From masks by id in the first photo to those in all of some photos, which are neighbours."""


@dataclass(frozen=True, eq=False)
class TrackingState:
    """What is known between two clips."""

    known: Labels | None = None
    """Objects that were propagated into the next keyframe; unusable if that is of another size."""
    missed: dict[int, int] = field(default_factory=dict)
    """In how many keyframes in a row an object was not detected again."""
    next_id: int = 1


def split_clips(cameras: Cameras) -> list[list[int]]:
    """Rows of photos in the order of the camera's path, cut at keyframes.

    Each clip but the last ends with the keyframe that the next one begins with, unless the photos'
    size changes there.
    """
    order, sizes = camera_path(cameras), cameras.sizes.tolist()
    clips, clip = [], [order[0]]
    for row in order[1:]:
        same_size = sizes[row] == sizes[clip[0]]
        if same_size:
            clip.append(row)
        if not same_size or len(clip) == CLIP + 1:
            clips.append(clip)
            clip = [row]
    clips.append(clip)
    # A keyframe alone, which the clip before has labelled, is no clip
    return [clip for k, clip in enumerate(clips) if k == 0 or clip != clips[k - 1][-1:]]


def camera_path(cameras: Cameras) -> list[int]:
    """Rows in the order of the files, or of the nearest cameras if that path is shorter."""
    positions = cameras.positions.cpu().numpy()
    forward = cameras.viewmats[:, 2, :3].cpu().numpy()
    scale = max(float(cdist(positions, positions.mean(axis=0)[None]).mean()), 1e-9)
    sizes = cameras.sizes.numpy()
    steps = torch.from_numpy(
        cdist(positions, positions) / scale
        + cdist(forward, forward)
        + (cdist(sizes, sizes) > 0) * OTHER_SIZE
    )
    as_named = [*range(len(cameras))]
    greedy, left = [0], set(as_named[1:])
    while left:
        nearest = min(left, key=lambda row: float(steps[greedy[-1], row]))
        greedy.append(nearest)
        left.remove(nearest)
    return min(as_named, greedy, key=lambda order: float(steps[order[:-1], order[1:]].sum()))


def track_clip(
    rows: Sequence[int], state: TrackingState, segmenter: Segmenter
) -> tuple[dict[int, Labels], TrackingState]:
    """Label a clip by objects detected in its first photo; the maps by row, and the next state."""
    views = list(_hypotheses(rows[:TRACK_WINDOW], segmenter))
    size = segmenter.size(rows[0])
    same_size = state.known is not None and state.known.shape == size
    known = labels_to_masks(state.known) if state.known is not None and same_size else {}
    masks, detected = associate_ids(known, confirm_masks(views), state.next_id)
    next_id = max([state.next_id - 1, *masks]) + 1
    missed = {id: 0 if id in detected else state.missed.get(id, 0) + 1 for id in masks}
    masks = {id: mask for id, mask in masks.items() if missed[id] < TRACK_PATIENCE}
    propagated = segmenter.propagate(rows, masks) if masks else [{} for _ in rows]
    maps = {row: masks_to_labels(each, size) for row, each in zip(rows, propagated, strict=True)}
    return maps, TrackingState(maps[rows[-1]], {id: missed[id] for id in masks}, next_id)


def _hypotheses(rows: Sequence[int], segmenter: Segmenter) -> Iterator[list[Mask]]:
    """What each photo shows, propagated into the first of them."""
    yield separate_masks(segmenter.propose(rows[0]))
    for row in rows[1:]:
        found = dict(enumerate(separate_masks(segmenter.propose(row)), start=1))
        yield [*segmenter.propagate([row, rows[0]], found)[-1].values()] if found else []


def separate_masks(masks: Sequence[Mask]) -> list[Mask]:
    """Masks that do not overlap: whole objects rather than their parts, nothing tiny or vast."""
    fit = [mask for mask in masks if mask.sum() <= TRACK_LARGEST * mask.numel()]
    return _subtract_better(sorted(fit, key=lambda mask: -int(mask.sum())))


def confirm_masks(views: Sequence[Sequence[Mask]]) -> list[Mask]:
    """The masks of one photo that its neighbours confirm; where only they have one, theirs.

    `views` are what was found in the photo, then what was found in each neighbour, propagated into
    it. The masks do not overlap, and those that most photos agree on come first.
    """
    pool = [(view, mask) for view, masks in enumerate(views) for mask in masks]
    if not pool:
        return []
    masks = [mask for _, mask in pool]
    same = _ious(masks, masks) >= TRACK_SAME_IOU
    origin = torch.tensor([view for view, _ in pool])
    support = [len(origin[row].unique()) for row in same]
    enough = min(CONFIRMATIONS, len(views))
    order = sorted(range(len(pool)), key=lambda i: (-support[i], pool[i][0], -int(masks[i].sum())))
    return _subtract_better([masks[i] for i in order if support[i] >= enough])


def associate_ids(
    known: Mapping[int, Mask], found: Sequence[Mask], next_id: int
) -> tuple[dict[int, Mask], set[int]]:
    """Give masks of a photo, which do not overlap, the ids of `known` ones propagated there.

    Returns masks by id that do not overlap: the found ones with the ids of known ones, known ones
    that were not found again, and new ones where nothing is known; and the ids that were found.
    """
    ids = [*known]
    ious = _ious([*known.values()], found)
    pairs = zip(*linear_sum_assignment(ious.numpy(), maximize=True), strict=True)
    matches = {ids[i]: int(j) for i, j in pairs if ious[i, j] >= TRACK_SAME_IOU}
    result = {}
    for id, mask in known.items():
        if id in matches:
            # A mask of two objects must not swallow the other
            others = [other for each, other in known.items() if each != id]
            mask = found[matches[id]] & ~_union(others, like=mask)
        result[id] = mask
    fresh = [mask for j, mask in enumerate(found) if j not in matches.values()]
    # The rest of a known object, of which less was found, is not a new object either
    taken = [*known.values(), *result.values()]
    for mask in _subtract_better(fresh, taken=_union(taken, like=fresh[0]) if fresh else None):
        result[next_id] = mask
        next_id += 1
    return result, {*matches, *(id for id in result if id not in known)}


def masks_to_labels(masks: Mapping[int, Mask], size: Sequence[int]) -> Labels:
    """A label map of masks that do not overlap."""
    labels = torch.full(tuple(size), BACKGROUND, dtype=torch.int64)
    for id, mask in masks.items():
        labels[mask] = id
    return labels


def labels_to_masks(labels: Labels) -> dict[int, Mask]:
    """The masks of a label map by id, without background."""
    return {id: labels == id for id in labels.unique().tolist() if id != BACKGROUND}


def _subtract_better(masks: Sequence[Mask], taken: Mask | None = None) -> list[Mask]:
    """Each mask without what is taken and the masks before it, unless little is left of it."""
    kept = []
    for mask in masks:
        free = mask if taken is None else mask & ~taken
        area, left = int(mask.sum()), int(free.sum())
        if left >= max(SMALLEST_PART * mask.numel(), MIN_FREE * area, 1):
            kept.append(free)
            taken = free if taken is None else taken | free
    return kept


def _union(masks: Sequence[Mask], *, like: Mask) -> Mask:
    return torch.stack([*masks, torch.zeros_like(like)]).any(dim=0)


def _ious(some: Sequence[Mask], others: Sequence[Mask]) -> Float[Tensor, "A B"]:
    """IoU of every mask with every other, from every second pixel along x and y."""
    thin_some, thin_others = ([mask[::2, ::2] for mask in masks] for masks in (some, others))
    return pairwise_iou(thin_some, thin_others)

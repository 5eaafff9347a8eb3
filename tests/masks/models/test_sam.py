"""Loading each family, and following objects with models of the real architectures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.masks.models import follow
from stylesplat.masks.models.follow import MemoryFollower, _part
from stylesplat.masks.models.sam import Follower, Method, Proposer, load_follower, load_proposer

FOLLOWING = ["sam2", "edgetam", "sam3"]
HEIGHT, WIDTH = 40, 56
SEEDS = {3: torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)}
SEEDS[3][5:20, 5:20] = True
SEEDS[300] = SEEDS[3].roll((20, 30), dims=(0, 1))

Models = Callable[[str], Path]


def noise(count: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(0)
    size = (count, HEIGHT, WIDTH, 3)
    return list(torch.randint(0, 256, size, generator=generator, dtype=torch.uint8))


def loaded(tiny_model: Models, kind: str, *, presence: float) -> MemoryFollower:
    """A follower that is this sure, as a logit, that objects are there."""
    follower = load_follower(kind, str(tiny_model(kind)))  # pyright: ignore[reportArgumentType]
    head = follower.model.mask_decoder.pred_obj_score_head.proj_out
    head.weight.zero_()
    head.bias.fill_(presence)
    return follower


@pytest.mark.parametrize("method", get_args(Method))
def test_every_family_proposes_masks(method: Method, tiny_model: Models):
    proposer = load_proposer(method, str(tiny_model(method)))
    assert isinstance(proposer, Proposer)
    loose = {"min_iou": -1e9, "min_stability": 0.0, "max_overlap": 1.0, "points_per_side": 3}
    (photo,) = noise(1)
    found = {}
    for count in (2, 4, 9):
        narrowed = type(proposer)(proposer.model, proposer.processor, points_at_once=count, **loose)
        found[count] = narrowed.propose(photo)
    assert len(found[9]) > 9, "more than one mask for a point"
    for masks in found.values():
        assert len(masks) == len(found[9])
        for mask, same in zip(masks, found[9], strict=True):
            assert mask.dtype == torch.bool and mask.shape == (HEIGHT, WIDTH) and mask.any()
            # Sums in another order may move a border pixel
            assert (mask != same).float().mean() < 0.01
    assert type(proposer)(proposer.model, proposer.processor, min_iou=1e9).propose(photo) == []


@pytest.mark.parametrize("kind", FOLLOWING)
def test_objects_are_followed(kind: str, tiny_model: Models):
    photos = noise(4)
    follower = loaded(tiny_model, kind, presence=5.0)
    assert isinstance(follower, Follower)
    found = follower.follow(photos, SEEDS)
    assert len(found) == 4
    assert found[0].keys() == SEEDS.keys()
    assert all(torch.equal(found[0][id], SEEDS[id]) for id in SEEDS)
    assert any(found[1:]), "weights that show nothing test nothing"
    for masks in found[1:]:
        assert masks.keys() <= SEEDS.keys()
        for mask in masks.values():
            assert mask.dtype == torch.bool and mask.shape == (HEIGHT, WIDTH) and mask.any()
            assert not mask.requires_grad
        if masks:
            assert torch.stack([*masks.values()]).sum(dim=0).max() == 1, "they do not overlap"


@pytest.mark.parametrize("kind", FOLLOWING)
def test_the_same_as_transformers_finds(kind: str, tiny_model: Models, monkeypatch):
    """With all memories kept and the whole video prepared at once: ours forgets and is lazy."""
    photos = noise(9)  # more than the 3 memories and 4 pointers that are recalled
    follower = loaded(tiny_model, kind, presence=5.0)
    logits = []

    def noted(part: Tensor, *rest: Any) -> dict[int, Tensor]:
        logits.append(part)
        return _part(part, *rest)

    monkeypatch.setattr(follow, "_part", noted)
    follower.follow(photos, SEEDS)
    images = [photo.numpy() for photo in photos]
    pixels = follower.processor.image_processor(images=images, return_tensors="pt").pixel_values
    session = follower.processor.init_video_session()
    session.processed_frames = dict(enumerate(pixels))
    follower.processor.add_inputs_to_inference_session(
        session, frame_idx=0, obj_ids=[*SEEDS], input_masks=[*SEEDS.values()]
    )
    frames = follower.model.propagate_in_video_iterator(session, start_frame_idx=0)
    expected = [frame.pred_masks[:, 0] for frame in frames][1:]
    assert len(logits) == 8 and torch.stack(expected).std() > 0
    torch.testing.assert_close(torch.stack(logits), torch.stack(expected))


def test_memory_does_not_grow_with_the_photos(tiny_model: Models, monkeypatch):
    follower = loaded(tiny_model, "sam2", presence=5.0)
    sessions = []
    opened = MemoryFollower._session
    monkeypatch.setattr(
        MemoryFollower, "_session", lambda *a: sessions.append(opened(*a)) or sessions[-1]
    )
    follower.follow(noise(9), SEEDS)
    for outputs in sessions[0].output_dict_per_obj.values():
        assert [*outputs["cond_frame_outputs"]] == [0]
        assert [*outputs["non_cond_frame_outputs"]] == [5, 6, 7, 8]
        for memories in outputs.values():
            assert not any(
                {"high_res_masks", "pred_masks"} & kept.keys() for kept in memories.values()
            )


@pytest.mark.parametrize("kind", FOLLOWING)
def test_what_the_model_says_is_absent_is_left_out(kind: str, tiny_model: Models):
    found = loaded(tiny_model, kind, presence=-5.0).follow(noise(3), SEEDS)
    assert found[0].keys() == SEEDS.keys()
    assert found[1:] == [{}, {}]


def test_without_seeds_the_model_is_not_asked():
    follower = MemoryFollower(model=None, processor=None)
    assert follower.follow(noise(3), {}) == [{}, {}, {}]
    assert follower.follow([], {}) == []
    empty = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    assert follower.follow(noise(2), {5: empty}) == [{}, {}]
    (only,) = follower.follow(noise(1), SEEDS)
    assert only.keys() == SEEDS.keys()


def test_the_seeds_are_left_as_they_are(tiny_model: Models):
    seeds = {id: mask.clone() for id, mask in SEEDS.items()}
    loaded(tiny_model, "sam2", presence=5.0).follow(noise(2), seeds)
    assert [*seeds] == [*SEEDS]
    assert all(torch.equal(seeds[id], SEEDS[id]) for id in SEEDS)


def test_pixels_go_to_the_surest_object():
    logits = torch.full((3, 4, 6), -4.0)
    logits[0, :, 2:] = 5.0
    logits[1, :, :4] = 2.0
    logits[2] = 9.0
    masks = _part(logits, torch.tensor([1.0, 0.5, -0.1]), (4, 6))
    assert masks.keys() == {0, 1}, "the third is not there"
    assert masks[0].all(dim=0).tolist() == [False, False, True, True, True, True]
    assert masks[1].all(dim=0).tolist() == [True, True, False, False, False, False]


def test_an_object_that_is_hidden_by_surer_ones_is_left_out():
    logits = torch.stack([torch.full((4, 6), 1.0), torch.full((4, 6), 2.0)])
    assert _part(logits, torch.ones(2), (8, 12)).keys() == {1}


def test_masks_are_enlarged_smoothly():
    logits = torch.tensor([[[-1.0, 3.0]]])
    (mask,) = _part(logits, torch.ones(1), (2, 8)).values()
    # Pixel centres of the small mask lie at 2 and 6; the line from -1 to 3 crosses 0 at 3
    assert mask[0].tolist() == [False] * 3 + [True] * 5


def test_sam_cannot_follow():
    with pytest.raises(StyleSplatError, match=r"single photos.*Use sam2 or edgetam or sam3\."):
        load_follower("sam")


@pytest.mark.parametrize(
    ("load", "method", "kind", "match"),
    [
        (load_proposer, "sam2", "sam", "is of the type sam. To propose masks with sam2"),
        (load_proposer, "sam", "sam3", "is of the type sam3_video.*one of the type sam$"),
        (load_follower, "edgetam", "sam2", "is of the type sam2_video. To follow objects"),
        (load_follower, "sam3", "grounding-dino", "sam3_tracker_video or sam3_video"),
    ],
)
def test_a_model_of_another_family(
    load: Callable, method: str, kind: str, match: str, tiny_model: Models
):
    with pytest.raises(StyleSplatError, match=match.replace("$", r"\.$")):
        load(method, str(tiny_model(kind)))

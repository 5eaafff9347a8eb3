"""Models of the real architectures: loading, proposals from a grid, propagation to other photos."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest
import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.masks.sam import GridProposer, SamMethod, load_propagator, load_proposer
from stylesplat.masks.tracking import VideoPropagator, split_by_logit

VIDEO = ["sam2", "edgetam", "sam3"]
HEIGHT, WIDTH = 40, 56
SEEDS = {3: torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)}
SEEDS[3][5:20, 5:20] = True
SEEDS[300] = SEEDS[3].roll((20, 30), dims=(0, 1))

Models = Callable[[str], Path]


def noise(count: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(0)
    size = (count, HEIGHT, WIDTH, 3)
    return list(torch.randint(0, 256, size, generator=generator, dtype=torch.uint8))


@pytest.mark.parametrize("method", get_args(SamMethod))
def test_every_family_proposes_masks(method: SamMethod, tiny_model: Models):
    proposer = load_proposer(method, str(tiny_model(method)))
    loose = {"min_iou": -1e9, "min_stability": 0.0, "max_overlap": 1.0, "points_per_side": 3}
    (photo,) = noise(1)
    found = {}
    for count in (4, 9):
        found[count] = replace(proposer, points_at_once=count, **loose).propose(photo)
    assert len(found[4]) == len(found[9]) > 9, "more than one mask for a point"
    for mask, same in zip(found[4], found[9], strict=True):
        assert mask.dtype == torch.bool and mask.shape == (HEIGHT, WIDTH) and mask.any()
        # Sums in another order may move a border pixel
        assert (mask != same).float().mean() < 0.01
    assert replace(proposer, min_iou=1e9).propose(photo) == []


@pytest.mark.parametrize("kind", VIDEO)
def test_the_same_as_transformers_finds(kind: str, tiny_model: Models):
    """With all masks kept: ours drops those that are not read again."""
    photos = noise(6)
    propagator = load_propagator(kind, str(tiny_model(kind)))  # pyright: ignore[reportArgumentType]
    head = propagator.model.mask_decoder.pred_obj_score_head.proj_out  # how sure, as a logit
    head.weight.zero_()
    head.bias.fill_(5.0)
    sessions, logits = [], []

    def model(session: Any, frame_idx: int) -> Any:
        output = propagator.model(session, frame_idx=frame_idx)
        logits.append(output.pred_masks[:, 0])
        sessions.append(session)
        return output

    model.device, model.dtype, model.config = (  # pyright: ignore[reportFunctionMemberAccess]
        *(propagator.model.device, propagator.model.dtype),
        propagator.model.config,
    )
    found = VideoPropagator(model, propagator.processor).propagate(photos, SEEDS)
    assert found[0] == SEEDS and any(found[1:]), "weights that show nothing test nothing"
    for masks in filter(None, found[1:]):
        assert masks.keys() <= SEEDS.keys()
        assert all(mask.shape == (HEIGHT, WIDTH) and mask.any() for mask in masks.values())
        assert torch.stack([*masks.values()]).sum(dim=0).max() == 1, "they do not overlap"
    head.bias.fill_(-5.0)
    absent = propagator.propagate(photos[:3], SEEDS)
    assert absent[0].keys() == SEEDS.keys() and absent[1:] == [{}, {}]
    head.bias.fill_(5.0)
    images = [photo.numpy() for photo in photos]
    pixels = propagator.processor.image_processor(images=images, return_tensors="pt").pixel_values
    session = propagator.processor.init_video_session()
    session.processed_frames = dict(enumerate(pixels))
    propagator.processor.add_inputs_to_inference_session(
        session, frame_idx=0, obj_ids=[*SEEDS], input_masks=[*SEEDS.values()]
    )
    frames = propagator.model.propagate_in_video_iterator(session, start_frame_idx=0)
    expected = [frame.pred_masks[:, 0] for frame in frames][1:]
    assert len(logits) == 6 and torch.stack(expected).std() > 0
    torch.testing.assert_close(torch.stack(logits[1:]), torch.stack(expected))
    # Memory does not grow with the photos
    for outputs in sessions[0].output_dict_per_obj.values():
        for memories in outputs.values():
            assert not any(
                {"high_res_masks", "pred_masks"} & kept.keys() for kept in memories.values()
            )


def test_without_seeds_the_model_is_not_asked():
    propagator = VideoPropagator(model=None, processor=None)
    assert propagator.propagate(noise(3), {}) == [{}, {}, {}]
    assert propagator.propagate([], {}) == []
    empty = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    assert propagator.propagate(noise(2), {5: empty}) == [{}, {}]
    (only,) = propagator.propagate(noise(1), SEEDS)
    assert only.keys() == SEEDS.keys()


def test_pixels_go_to_the_surest_object():
    logits = torch.full((3, 4, 6), -4.0)
    logits[0, :, 2:] = 5.0
    logits[1, :, :4] = 2.0
    logits[2] = 9.0
    masks = split_by_logit(logits, torch.tensor([1.0, 0.5, -0.1]), (4, 6))
    assert masks.keys() == {0, 1}, "the third is not there"
    assert masks[0].all(dim=0).tolist() == [False, False, True, True, True, True]
    assert masks[1].all(dim=0).tolist() == [True, True, False, False, False, False]
    hidden = torch.stack([torch.full((4, 6), 1.0), torch.full((4, 6), 2.0)])
    assert split_by_logit(hidden, torch.ones(2), (8, 12)).keys() == {1}
    (mask,) = split_by_logit(torch.tensor([[[-1.0, 3.0]]]), torch.ones(1), (2, 8)).values()
    # Pixel centres of the small mask lie at 2 and 6; the line from -1 to 3 crosses 0 at 3
    assert mask[0].tolist() == [False] * 3 + [True] * 5


@pytest.mark.parametrize(
    ("load", "method", "kind", "match"),
    [
        (load_proposer, "sam2", "sam", "is of the type sam. To propose masks with sam2"),
        (load_propagator, "sam3", "grounding-dino", "sam3_tracker_video or sam3_video"),
    ],
)
def test_a_model_of_another_family(
    load: Callable, method: str, kind: str, match: str, tiny_model: Models
):
    with pytest.raises(StyleSplatError, match=match):
        load(method, str(tiny_model(kind)))


SIDE, SMALL = 64, 16  # pixels of the scripted model's input and of its masks
Answer = tuple[slice, slice, float, float]  # rows and columns of a mask, its logit, its quality


@dataclass
class Script:
    """Answers three masks for every point: the last that lies there, and two bad ones."""

    answers: list[Answer]
    asked: list[Tensor] = field(default_factory=list)
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    dtype: torch.dtype = torch.float32

    def get_image_embeddings(self, pixels: Tensor) -> Tensor:
        return pixels

    def __call__(self, image_embeddings: Tensor, input_points: Tensor, input_labels: Tensor) -> Any:
        points = input_points[0, :, 0]
        assert input_labels.shape == (1, len(points), 1) and (input_labels == 1).all()
        self.asked.append(points)
        masks = torch.full((1, len(points), 3, SMALL, SMALL), -9.0)
        qualities = torch.zeros(1, len(points), 3)
        for number, (x, y) in enumerate((points * SMALL / SIDE).tolist()):
            for rows, columns, logit, quality in self.answers:
                if rows.start <= y < rows.stop and columns.start <= x < columns.stop:
                    masks[0, number, 1] = -9.0
                    masks[0, number, 1, rows, columns] = logit
                    qualities[0, number, 1] = quality
        return SimpleNamespace(pred_masks=masks, iou_scores=qualities)


LEFT = (slice(2, 14), slice(1, 7), 9.0, 0.90)
RIGHT = (slice(4, 12), slice(9, 15), 9.0, 0.95)


def proposer(script: Script, **settings: Any) -> GridProposer:
    from transformers import Sam2ImageProcessor

    processor = Sam2ImageProcessor(size={"height": SIDE, "width": SIDE})
    return GridProposer(script, processor, **{"points_per_side": 8, **settings})


def photo(height: int = 32, width: int = 64) -> Tensor:
    return torch.zeros(height, width, 3, dtype=torch.uint8)


def test_each_object_once_the_best_first():
    masks = proposer(Script([LEFT, RIGHT])).propose(photo())
    assert len(masks) == 2
    # 32 x 64 pixels: a small mask's pixel is 2 high and 4 wide
    right, left = masks
    for mask, (rows, columns) in (
        (right, (slice(8, 24), slice(36, 60))),
        (left, (slice(4, 28),) * 2),
    ):
        expected = torch.zeros_like(mask)
        expected[rows, columns] = True
        assert (mask != expected).sum() == 4, "all but the corners, which smooth enlarging cuts"


def test_masks_of_low_quality_or_with_an_uncertain_border_are_dropped():
    script = Script([LEFT, RIGHT])
    assert len(proposer(script, min_iou=0.92).propose(photo())) == 1
    assert proposer(script, min_iou=0.99).propose(photo()) == []
    faint = (*LEFT[:2], 0.5, 0.99)  # no pixel is above 1
    script = Script([faint, RIGHT])
    assert len(proposer(script).propose(photo())) == 1
    assert len(proposer(script, min_stability=0.0).propose(photo())) == 2
    nothing = (*LEFT[:2], -0.5, 0.99)
    assert proposer(Script([nothing]), min_stability=0.0).propose(photo()) == []


def test_the_grid_leaves_out_padding():
    """The first SAM keeps the photo's proportions and pads below or to the right."""
    from transformers import SamImageProcessor

    size = {"height": SIDE, "width": SIDE}
    processor = SamImageProcessor(size={"longest_edge": SIDE}, pad_size=size)
    script = Script([(slice(0, 8), slice(0, 8), 9.0, 0.9)])
    (mask,) = GridProposer(script, processor, points_per_side=4).propose(photo())
    points = torch.cat(script.asked)
    assert sorted(set(points[:, 0].tolist())) == [8, 24, 40, 56]
    assert sorted(set(points[:, 1].tolist())) == [4, 12, 20, 28]
    # The top left quarter of the padded square is the left half of the photo
    assert mask[:, :30].all() and not mask[:, 34:].any()

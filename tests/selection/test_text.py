"""Votes of scripted boxes; then of a detector of colours, and of real architectures."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from balls import CAMERAS, SPLATS
from capture_files import NOTHING, ColorDetector
from stylesplat.errors import StyleSplatError
from stylesplat.scene.sequences import farthest_views
from stylesplat.selection.text import (
    Detections,
    Detector,
    clear_winner,
    count_votes,
    load_detector,
    rank_objects,
)

Models = Callable[[str], Path]
Box = tuple[float, float, float, float]

WALL, VASE, CUP = 70000, 2, 3
VASE_BOX, CUP_BOX = (10.0, 5.0, 20.0, 25.0), (30.0, 15.0, 36.0, 21.0)


def labels() -> Tensor:
    """A wall that fills the picture, before it a vase and a cup, and a strip of nothing."""
    labels = torch.full((40, 60), WALL)
    labels[5:25, 10:20] = VASE
    labels[15:21, 30:36] = CUP
    labels[38:] = 0
    return labels


def found(*boxes: tuple[Box, float]) -> Detections:
    return Detections(torch.tensor([b for b, _ in boxes]), torch.tensor([s for _, s in boxes]))


def votes(*views: Detections) -> dict[int, float]:
    return count_votes((labels(), view) for view in views)


ONE, OTHER = found((VASE_BOX, 0.5)), found((CUP_BOX, 1.0))
LOOSE, AGAIN = (8.0, 4.0, 22.0, 27.0), (10.0, 5.0, 21.0, 25.0)


@pytest.mark.parametrize(
    ("views", "expected"),
    [
        ([found((VASE_BOX, 0.75))], {VASE: 0.75}),
        ([found((LOOSE, 0.5), (CUP_BOX, 0.25))], {VASE: 0.5, CUP: 0.25}),
        ([found((VASE_BOX, 0.5), (AGAIN, 0.75), (VASE_BOX, 0.25))], {VASE: 0.75}),  # one object
        ([ONE, ONE, ONE, OTHER], {VASE: 0.375, CUP: 0.25}),
        ([ONE, NOTHING], {VASE: 0.25}),  # a view that shows nothing counts
        ([NOTHING], {}),
        ([], {}),
    ],
)
def test_a_box_votes_with_its_score_for_what_it_fits(
    views: list[Detections], expected: dict[int, float]
):
    assert votes(*views) == expected
    assert count_votes((0 * labels(), view) for view in views) == {}


def test_a_clear_winner_is_no_chance_of_one_view():
    assert clear_winner({7: 0.5}, "ball") == 7
    assert clear_winner({7: 0.5, 3: 0.39, 9: 0.1}, "ball") == 7
    assert clear_winner(votes(*[found((VASE_BOX, 0.32))] * 2, *[NOTHING] * 6), "vase") == VASE
    assert clear_winner(votes(found((VASE_BOX, 0.7)), *[NOTHING] * 7), "vase") == VASE


@pytest.mark.parametrize(
    ("scores", "fact"),
    [
        ({VASE: 0.0625}, r"Hardly any view .* 'owl'.*: 2 \(0\.06\)\. .*--id"),
        (
            {7: 0.5, 3: 0.4, 9: 0.1},
            r"'owl' may mean .*: 7 \(0\.50\), 3 \(0\.40\), 9 \(0\.10\)\. .*--id",
        ),
        ({}, r"No object of the scene fits 'owl'\. .*`stylesplat objects 'my garden'`.*--id"),
    ],
)
def test_without_a_clear_winner_the_rivals_are_listed(scores: dict[int, float], fact: str):
    with pytest.raises(StyleSplatError, match=fact):
        clear_winner(scores, "owl", folder=Path("my garden"))


def test_no_view_is_taken_twice():
    same_place = CAMERAS[[0] * 5]
    assert sorted(farthest_views(same_place, 5)) == [0, 1, 2, 3, 4]
    assert len(farthest_views(same_place, 8)) == 5
    assert len(set(farthest_views(CAMERAS, 3))) == 3


@pytest.mark.parametrize(("phrase", "id"), [("red", 3), ("green", 7), ("blue", 300)])
def test_balls_are_found_by_their_colours(phrase: str, id: int):
    detector = ColorDetector()
    assert isinstance(detector, Detector)
    scores = rank_objects(SPLATS, CAMERAS, phrase, detector)
    assert clear_winner(scores, phrase) == id
    assert scores[id] > 0.6, "seen and found in most of eight views"
    assert detector.sizes == {(36, 48, 3)}


@pytest.mark.parametrize("kind", ["grounding-dino", "sam3"])
def test_real_architectures(kind: str, tiny_model: Models):
    detector = load_detector(str(tiny_model(kind)))
    assert isinstance(detector, Detector)
    generator = torch.Generator().manual_seed(0)
    picture = torch.randint(0, 256, (40, 60, 3), generator=generator, dtype=torch.uint8)
    all_boxes = replace(detector, min_score=0.0).detect(picture, "Red")
    assert len(all_boxes.boxes) == (6 if detector.grounded else 5), "one for each query"
    assert (all_boxes.scores > 0).all() and (all_boxes.scores <= 1).all()
    assert (all_boxes.boxes[:, 2:] >= all_boxes.boxes[:, :2]).all()
    assert all_boxes.boxes[:, ::2].max() > 40, "x reaches beyond the height: it is in pixels"
    between = float(all_boxes.scores.median())
    sure = replace(detector, min_score=between).detect(picture, "Red")
    assert 0 < len(sure.scores) < len(all_boxes.scores) and (sure.scores > between).all()
    assert len(replace(detector, min_score=1.0).detect(picture, "Red").boxes) == 0
    assert rank_objects(SPLATS, CAMERAS[:2], "red", detector).keys() <= {3, 7, 300}
    with pytest.raises(StyleSplatError, match=r"tokens, the model reads \d+\. Use fewer words"):
        detector.detect(picture, "red " * 40)
    with pytest.raises(StyleSplatError, match="To find objects by a phrase, pass one of"):
        load_detector(str(tiny_model("sam2")))

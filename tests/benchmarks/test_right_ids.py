import pytest
import torch
from right_ids import right_ids


def maps(*rows: list[int]) -> list[torch.Tensor]:
    """Label maps of one row of pixels each."""
    return [torch.tensor([row]) for row in rows]


TRUTH = maps([1, 1, 1, 1, 7, 7, 0, 0], [0, 1, 1, 1, 1, 7, 7, 0], [1, 1, 1, 1, 0, 0, 7, 7])


def measured(found: list[torch.Tensor], truth: list[torch.Tensor] = TRUTH) -> tuple[float, float]:
    result = right_ids(found, truth)
    return result.right_pixels, result.idf1


def test_the_truth_is_perfect_under_any_names():
    assert measured(TRUTH) == (1, 1)
    renamed = [torch.tensor([0, 300, 0, 0, 0, 0, 0, 2])[labels] for labels in TRUTH]
    assert measured(renamed) == (1, 1)


def test_ids_swapped_in_one_view():
    swapped = [torch.tensor([0, 7, 0, 0, 0, 0, 0, 1])[TRUTH[0]], *TRUTH[1:]]
    # 12 of 18 pixels; of 6 objects and 6 detections, 4 pairs are found under the right id
    assert measured(swapped) == (pytest.approx(12 / 18), pytest.approx(2 * 4 / 12))


def test_every_object_has_one_id_and_every_id_one_object():
    merged = [(labels > 0).long() for labels in TRUTH]
    # the larger object's 12 of 18 pixels, found (4 of 6 pixels) in 3 views where 2 + 1 are there
    assert measured(merged) == (pytest.approx(12 / 18), pytest.approx(2 * 3 / (6 + 3)))
    split = maps([1, 1, 5, 5, 7, 7, 0, 0], *(row[0].tolist() for row in TRUTH[1:]))
    # half of one object of six is lost, and two halves are detected; IoU 2 / 4 still counts
    assert measured(split) == (pytest.approx(16 / 18), pytest.approx(2 * 6 / (6 + 7)))


def test_the_pairs_are_those_that_get_most_right():
    # alone, 1 would stand for 1, with 3 pixels; but 1 for 7 and 5 for 1 get 2 + 2
    truth, found = maps([1, 1, 1, 1, 1, 7, 7]), maps([1, 1, 1, 5, 5, 1, 1])
    assert measured(found, truth)[0] == pytest.approx(4 / 7)


def test_what_is_found_on_background_costs_idf1_alone():
    more = [*TRUTH[:2], torch.tensor([[1, 1, 1, 1, 9, 9, 7, 7]])]
    assert measured(more) == (1, pytest.approx(2 * 6 / (6 + 7)))


def test_nothing_found_and_nothing_there():
    nothing = [torch.zeros_like(labels) for labels in TRUTH]
    assert measured(nothing) == (0, 0)
    assert measured(nothing, nothing) == (0, 0) and measured([], []) == (0, 0)


def test_views_may_differ_in_size_but_not_in_number():
    truth = [TRUTH[0], torch.tensor([[1, 7], [1, 0]])]
    assert measured(truth, truth) == (1, 1)
    with pytest.raises(ValueError, match="argument 2"):
        right_ids(TRUTH[:2], TRUTH)

import pytest
import torch

from stylesplat.masks.models.associate import apart, associate, confirmed, to_labels, to_masks


def box(x0: int, x1: int, y0: int = 0, y1: int = 40) -> torch.Tensor:
    """A rectangle in a photo of 40x100 pixels."""
    mask = torch.zeros(40, 100, dtype=torch.bool)
    mask[y0:y1, x0:x1] = True
    return mask


def noise(seed: int, count: int = 6) -> list[torch.Tensor]:
    """Boxes of any size that may overlap."""
    generator = torch.Generator().manual_seed(seed)
    corners = torch.rand(count, 2, 2, generator=generator).sort(dim=2).values
    corners = (corners * torch.tensor([[100], [40]])).long().tolist()
    return [box(x0, x1 + 1, y0, y1 + 1) for (x0, x1), (y0, y1) in corners]


def disjoint(masks) -> bool:
    return bool((torch.stack([*masks, box(0, 0)]).sum(dim=0) <= 1).all())


@pytest.mark.parametrize("seed", range(5))
def test_nothing_ever_overlaps(seed: int):
    views = [noise(seed), noise(seed + 100), noise(seed + 200)]
    assert disjoint(apart(views[0])) and disjoint(confirmed(views))
    known = dict(enumerate(apart(views[0]), start=1))
    masks, _ = associate(known, apart(views[1]), 50)
    assert disjoint(masks.values()) and {*known} <= {*masks}


def test_whole_objects_come_before_their_parts():
    whole, part, beside, tiny = box(0, 30), box(5, 20), box(25, 60), box(70, 71, 0, 1)
    assert [int(m.sum()) for m in apart([part, tiny, beside, whole])] == [35 * 40, 25 * 40]
    vast = box(0, 51)
    assert not apart([vast]) and not apart([])


def test_two_of_three_photos_must_agree():
    one, moved, other = box(0, 20), box(2, 21), box(50, 70)
    assert [m.tolist() for m in confirmed([[one, other], [moved], []])] == [one.tolist()]
    assert not confirmed([[one], [], []]) and not confirmed([[], [], []])
    assert not confirmed([[one, one], []])  # the same photo twice is one photo


def test_the_photos_own_mask_is_taken_if_it_has_one():
    one, moved, gone = box(0, 20), box(2, 21), box(50, 70)
    found = confirmed([[one], [moved, gone], [moved, gone]])
    assert [m.tolist() for m in found] == [one.tolist(), gone.tolist()]


def test_without_neighbours_all_is_taken():
    assert len(confirmed([[box(0, 20), box(30, 40)]])) == 2


def test_what_most_photos_agree_on_wins_over_the_photos_own_mask():
    whole, thirds = box(0, 39), [box(0, 13), box(13, 26), box(26, 39)]
    found = confirmed([[whole], thirds, thirds])
    assert [int(m.sum()) for m in found] == [13 * 40] * 3


def test_found_masks_take_the_ids_that_are_known():
    known = {4: box(0, 20), 9: box(30, 50)}
    masks, seen = associate(known, [box(32, 54), box(1, 20)], 10)
    assert {id: m.tolist() for id, m in masks.items()} == {
        4: box(1, 20).tolist(),
        9: box(32, 54).tolist(),
    }
    assert seen == {4, 9}


def test_what_is_not_found_again_stays_but_is_not_seen():
    masks, seen = associate({4: box(0, 20), 9: box(30, 50)}, [box(0, 20)], 10)
    assert masks[9].equal(box(30, 50)) and seen == {4}


def test_new_objects_get_new_ids():
    masks, seen = associate({4: box(0, 20)}, [box(40, 60), box(0, 20), box(70, 80)], 11)
    assert {*masks} == {4, 11, 12} and seen == {4, 11, 12}
    assert masks[11].equal(box(40, 60)) and masks[12].equal(box(70, 80))
    assert {*associate({}, [box(0, 9)], 1)[0]} == {1}
    assert associate({}, [], 1) == ({}, set())


def test_a_mask_of_two_objects_does_not_swallow_the_neighbour():
    known = {1: box(0, 30), 2: box(30, 40)}
    masks, seen = associate(known, [box(0, 42)], 3)
    assert masks[2].equal(box(30, 40)) and seen == {1}
    assert masks[1].equal(box(0, 30) | box(40, 42)) and {*masks} == {1, 2}


def test_a_fragment_gets_no_id():
    known = {1: box(0, 40)}
    for piece in (box(0, 10), box(35, 44, 0, 10)):
        masks, seen = associate(known, [piece], 2)
        assert {*masks} == {1} and masks[1].equal(box(0, 40)) and not seen
    assert {*associate(known, [box(60, 61, 0, 1)], 2)[0]} == {1}


def test_an_object_found_in_two_parts_does_not_become_two():
    masks, seen = associate({1: box(0, 40)}, [box(0, 24), box(24, 40)], 2)
    assert {*masks} == {1} and masks[1].equal(box(0, 24)) and seen == {1}


def test_a_new_object_beside_one_that_has_become_tiny():
    # What is left of a known object is too small to be found, and must not stand in the way
    masks, _ = associate({1: box(0, 1, 0, 1)}, [box(40, 60)], 2)
    assert {*masks} == {1, 2} and masks[2].equal(box(40, 60))


def test_label_maps_and_back():
    masks = {3: box(0, 20), 300: box(20, 50)}
    labels = to_labels(masks, (40, 100))
    assert labels.unique().tolist() == [0, 3, 300]
    back = to_masks(labels)
    assert {*back} == {*masks} and all(back[id].equal(masks[id]) for id in masks)
    assert not to_labels({}, (40, 100)).any() and not to_masks(to_labels({}, (4, 4)))

"""From proposals in single photos to label maps: clips, confirmation, association of ids."""

from collections.abc import Iterator
from itertools import pairwise

import pytest
import torch

from balls import CAMERAS
from stylesplat.masks.tracking import (
    CLIP,
    TRACK_PATIENCE,
    Segmenter,
    TrackingState,
    associate_ids,
    camera_path,
    confirm_masks,
    labels_to_masks,
    separate_masks,
    split_clips,
    track_clip,
)
from stylesplat.scene.cameras import Cameras


def along_a_line(places: list[float], sizes: list[tuple[int, int]] | None = None) -> Cameras:
    """Cameras that look along z from places along x."""
    count = len(places)
    viewmats = torch.eye(4).repeat(count, 1, 1)
    viewmats[:, 0, 3] = -torch.tensor(places)
    return Cameras(
        viewmats=viewmats,
        Ks=torch.eye(3).repeat(count, 1, 1),
        sizes=torch.tensor(sizes or [(48, 36)] * count),
        names=tuple(f"{i:03d}.jpg" for i in range(count)),
    )


def test_the_order_of_a_video_is_kept_and_shuffled_photos_are_put_in_order():
    assert camera_path(CAMERAS) == [*range(8)]
    both_ways = [0.0, -1.1, -2.2, -1.0, 0.1, 1.3, 2.6]  # going to the nearest jumps at the end
    assert camera_path(along_a_line(both_ways)) == [*range(7)]
    shuffled = torch.randperm(20, generator=torch.Generator().manual_seed(0)).tolist()
    start = shuffled.index(0)
    order = [start, *(k for k in range(20) if k != start)]  # one end of the line first
    places = [float(shuffled[k]) for k in order]
    path = camera_path(along_a_line(places))
    assert sorted(path) == [*range(20)]
    assert [places[row] for row in path] == [float(i) for i in range(20)]


@pytest.mark.parametrize("count", [1, CLIP, CLIP + 1, 23])
def test_clips_meet_at_keyframes(count: int):
    clips = split_clips(along_a_line([float(i) for i in range(count)]))
    rows = [row for k, clip in enumerate(clips) for row in clip[k > 0 :]]
    assert rows == [*range(count)]
    assert all(one[-1] == other[0] for one, other in pairwise(clips))
    assert all(len(clip) == CLIP + 1 for clip in clips[:-1])
    assert count == 1 or all(len(clip) > 1 for clip in clips)


@pytest.mark.parametrize("first", [1, CLIP + 1, CLIP + 2])
def test_clips_end_where_the_size_changes(first: int):
    sizes = [(48, 36)] * first + [(36, 48)] * 3
    parts = split_clips(along_a_line([float(i) for i in range(first + 3)], sizes))
    assert parts[-1] == [first, first + 1, first + 2]
    assert sorted({row for part in parts for row in part}) == [*range(first + 3)]
    assert all(len({sizes[row] for row in part}) == 1 for part in parts)
    assert len(parts) == (3 if first == CLIP + 2 else 2)


def scripted(truth: list[torch.Tensor], seen: dict[int, set[int]] | None = None) -> Segmenter:
    """Follows exactly; in some photos finds only some of the objects."""

    def propose(row: int) -> list[torch.Tensor]:
        found = labels_to_masks(truth[row])
        return [m for id, m in found.items() if seen is None or id in seen.get(row, found)]

    def follow(rows, seeds) -> Iterator[dict[int, torch.Tensor]]:
        start = labels_to_masks(truth[rows[0]])
        same = {id: [o for o, m in start.items() if (m & seed).any()] for id, seed in seeds.items()}
        for row in rows:
            masks = labels_to_masks(truth[row])
            yield {id: masks[o] for id, os in same.items() for o in os if o in masks}

    def size(row: int) -> tuple[int, int]:
        return truth[row].shape[0], truth[row].shape[1]

    return Segmenter(size, propose, lambda *a: [*follow(*a)])


def sliding(count: int, ids: tuple[int, ...] = (3, 7)) -> list[torch.Tensor]:
    """Squares that move to the right by a pixel per photo."""
    maps = []
    for row in range(count):
        labels = torch.zeros(40, 120, dtype=torch.int64)
        for place, id in enumerate(ids):
            labels[10:30, row + 30 * place : row + 30 * place + 20] = id
        maps.append(labels)
    return maps


def tracked(segmenter: Segmenter, count: int) -> tuple[list[torch.Tensor], TrackingState]:
    state, maps = TrackingState(), {}
    for rows in split_clips(along_a_line([float(i) for i in range(count)])):
        found, state = track_clip(rows, state, segmenter)
        maps |= found
    return [maps[row] for row in range(count)], state


def keys(count: int) -> list[int]:
    return [part[0] for part in split_clips(along_a_line([float(i) for i in range(count)]))]


def unseen(key: int, id: int) -> dict[int, set[int]]:
    """What is found where one object is missed in a key photo and those that vote on it."""
    return {row: {3, 7} - {id} for row in range(key, key + 3)}


def test_an_object_missed_once_is_kept_and_one_missed_for_long_is_given_up():
    count = 5 * CLIP + 1
    truth, (_, *later) = sliding(count), keys(count)
    maps, state = tracked(scripted(truth, unseen(later[0], 7)), count)
    assert all((labels > 0).equal(exact > 0) for labels, exact in zip(maps, truth, strict=True))
    assert state.next_id == 3 and state.missed == {1: 0, 2: 0}
    lost = {row: found for key in later[:TRACK_PATIENCE] for row, found in unseen(key, 7).items()}
    maps, state = tracked(scripted(truth, lost), count)
    given_up = later[TRACK_PATIENCE - 1]
    found = [bool(labels[exact == 7].any()) for labels, exact in zip(maps, truth, strict=True)]
    again = later[TRACK_PATIENCE]
    assert found == [row < given_up or row >= again for row in range(count)]
    assert state.next_id == 4  # found anew, not under an id that was in use


def test_ids_are_not_reused_after_photos_of_another_size():
    truth = sliding(3)
    turned = [labels.T.contiguous() for labels in truth]
    _, state = track_clip([0, 1, 2], TrackingState(), scripted(truth))
    maps, state = track_clip([0, 1, 2], state, scripted(turned))
    assert maps[0].unique().tolist() == [0, 3, 4] and state.next_id == 5
    assert maps[2].shape == turned[0].shape


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


@pytest.mark.parametrize("seed", range(3))
def test_nothing_ever_overlaps(seed: int):
    views = [noise(seed), noise(seed + 100), noise(seed + 200)]
    assert disjoint(separate_masks(views[0])) and disjoint(confirm_masks(views))
    known = dict(enumerate(separate_masks(views[0]), start=1))
    masks, _ = associate_ids(known, separate_masks(views[1]), 50)
    assert disjoint(masks.values()) and {*known} <= {*masks}


def test_whole_objects_come_before_their_parts():
    whole, part, beside, tiny = box(0, 30), box(5, 20), box(25, 60), box(70, 71, 0, 1)
    assert [int(m.sum()) for m in separate_masks([part, tiny, beside, whole])] == [35 * 40, 25 * 40]
    vast, close = box(0, 81), box(0, 60)
    assert not separate_masks([vast]) and not separate_masks([])
    assert len(separate_masks([close])) == 1


def test_two_of_three_photos_must_agree():
    one, moved, other = box(0, 20), box(2, 21), box(50, 70)
    assert [m.tolist() for m in confirm_masks([[one, other], [moved], []])] == [one.tolist()]
    assert not confirm_masks([[one], [], []]) and not confirm_masks([[], [], []])
    assert not confirm_masks([[one, one], []])  # the same photo twice is one photo
    found = confirm_masks([[one], [moved, other], [moved, other]])
    assert [m.tolist() for m in found] == [one.tolist(), other.tolist()], "its own mask first"


def test_found_masks_take_known_ids_and_new_objects_new_ones():
    known = {4: box(0, 20), 9: box(30, 50), 5: box(60, 70)}
    found = [box(32, 54), box(1, 20), box(80, 90)]
    masks, seen = associate_ids(known, found, 10)
    expected = {4: box(1, 20), 9: box(32, 54), 5: box(60, 70), 10: box(80, 90)}
    assert {*masks} == {*expected} and all(masks[id].equal(expected[id]) for id in masks)
    assert seen == {4, 9, 10}, "the object that was not found again stays, but is not seen"
    assert associate_ids({}, [], 1) == ({}, set())


def test_a_mask_of_two_objects_does_not_swallow_the_neighbour():
    known = {1: box(0, 30), 2: box(30, 40)}
    masks, seen = associate_ids(known, [box(0, 42)], 3)
    assert masks[2].equal(box(30, 40)) and seen == {1}
    assert masks[1].equal(box(0, 30) | box(40, 42)) and {*masks} == {1, 2}

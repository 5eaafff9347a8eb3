from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from balls import CAMERAS
from stylesplat.masks.models.associate import to_masks
from stylesplat.masks.models.track import (
    PATIENCE,
    STRETCH,
    Segmenter,
    State,
    camera_path,
    stretches,
    track,
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


def test_the_order_of_a_video_is_kept():
    assert camera_path(CAMERAS) == [*range(8)]
    both_ways = [0.0, -1.1, -2.2, -1.0, 0.1, 1.3, 2.6]  # going to the nearest jumps at the end
    assert camera_path(along_a_line(both_ways)) == [*range(7)]


def test_shuffled_photos_are_put_in_order():
    shuffled = torch.randperm(20, generator=torch.Generator().manual_seed(0)).tolist()
    start = shuffled.index(0)
    order = [start, *(k for k in range(20) if k != start)]  # one end of the line first
    places = [float(shuffled[k]) for k in order]
    path = camera_path(along_a_line(places))
    assert sorted(path) == [*range(20)]
    assert [places[row] for row in path] == [float(i) for i in range(20)]


def test_directions_count_as_places_do():
    turning = [0.0, 2.0, 0.5, 2.5, 1.0, 3.0, 1.5]  # radians, in one place
    viewmats = torch.eye(4).repeat(7, 1, 1)
    for row, angle in enumerate(torch.tensor(turning)):
        sin, cos = angle.sin(), angle.cos()
        viewmats[row, :3, :3] = torch.tensor([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    cameras = replace(along_a_line([0.0] * 7), viewmats=viewmats)
    assert [turning[row] for row in camera_path(cameras)] == sorted(turning)


def test_photos_of_one_size_come_together():
    sizes = [(48, 36), (36, 48)] * 4
    path = camera_path(along_a_line([float(i) for i in range(8)], sizes))
    assert sorted(path[:4]) == [0, 2, 4, 6] and sorted(path[4:]) == [1, 3, 5, 7]
    assert stretches(along_a_line([0.0, 1.0, 2.0], sizes[:3])) == [[0, 2], [1]]


@pytest.mark.parametrize("count", [1, 2, STRETCH, STRETCH + 1, STRETCH + 2, 2 * STRETCH + 1, 23])
def test_stretches_meet_at_key_photos(count: int):
    parts = stretches(along_a_line([float(i) for i in range(count)]))
    rows = [row for k, part in enumerate(parts) for row in part[k > 0 :]]
    assert rows == [*range(count)]
    assert all(one[-1] == other[0] for one, other in pairwise(parts))
    assert all(len(part) == STRETCH + 1 for part in parts[:-1])
    assert count == 1 or all(len(part) > 1 for part in parts)


@pytest.mark.parametrize("first", [1, 2, STRETCH, STRETCH + 1, STRETCH + 2])
def test_stretches_end_where_the_size_changes(first: int):
    sizes = [(48, 36)] * first + [(36, 48)] * 3
    parts = stretches(along_a_line([float(i) for i in range(first + 3)], sizes))
    assert parts[-1] == [first, first + 1, first + 2]
    assert sorted({row for part in parts for row in part}) == [*range(first + 3)]
    assert all(len({sizes[row] for row in part}) == 1 for part in parts)
    assert len(parts) == (3 if first == STRETCH + 2 else 2)


def scripted(truth: list[torch.Tensor], seen: dict[int, set[int]] | None = None) -> Segmenter:
    """Follows exactly; in some photos finds only some of the objects."""

    def propose(row: int) -> list[torch.Tensor]:
        found = to_masks(truth[row])
        return [m for id, m in found.items() if seen is None or id in seen.get(row, found)]

    def follow(rows, seeds) -> Iterator[dict[int, torch.Tensor]]:
        start = to_masks(truth[rows[0]])
        same = {id: [o for o, m in start.items() if (m & seed).any()] for id, seed in seeds.items()}
        for row in rows:
            masks = to_masks(truth[row])
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


def tracked(segmenter: Segmenter, count: int) -> tuple[list[torch.Tensor], State]:
    state, maps = State(), {}
    for rows in stretches(along_a_line([float(i) for i in range(count)])):
        found, state = track(rows, state, segmenter)
        maps |= found
    return [maps[row] for row in range(count)], state


def test_ids_survive_along_the_path():
    truth = sliding(23)
    maps, state = tracked(scripted(truth), 23)
    for labels, exact in zip(maps, truth, strict=True):
        names = {int(labels[exact == id].unique()): id for id in (3, 7)}
        assert {*names} == {1, 2} and names == {1: int(truth[0][maps[0] == 1][0]), 2: names[2]}
        assert not labels[exact == 0].any()
    assert state.next_id == 3 and state.missed == {1: 0, 2: 0}


def keys(count: int) -> list[int]:
    return [part[0] for part in stretches(along_a_line([float(i) for i in range(count)]))]


def unseen(key: int, id: int) -> dict[int, set[int]]:
    """What is found where one object is missed in a key photo and those that vote on it."""
    return {row: {3, 7} - {id} for row in range(key, key + 3)}


def test_an_object_missed_once_is_kept_and_one_missed_for_long_is_given_up():
    count = 5 * STRETCH + 1
    truth, (_, *later) = sliding(count), keys(count)
    maps, state = tracked(scripted(truth, unseen(later[0], 7)), count)
    assert all((labels > 0).equal(exact > 0) for labels, exact in zip(maps, truth, strict=True))
    assert state.next_id == 3 and state.missed == {1: 0, 2: 0}
    lost = {row: found for key in later[:PATIENCE] for row, found in unseen(key, 7).items()}
    maps, state = tracked(scripted(truth, lost), count)
    given_up = later[PATIENCE - 1]
    found = [bool(labels[exact == 7].any()) for labels, exact in zip(maps, truth, strict=True)]
    again = later[PATIENCE]
    assert found == [row < given_up or row >= again for row in range(count)]
    assert state.next_id == 4  # found anew, not under an id that was in use


def test_missing_an_object_now_and_then_is_no_reason_to_give_it_up():
    count = (2 * PATIENCE + 1) * STRETCH + 1
    lost = {row: found for key in keys(count)[1::2] for row, found in unseen(key, 7).items()}
    maps, state = tracked(scripted(sliding(count), lost), count)
    assert state.next_id == 3 and all(len(labels.unique()) == 3 for labels in maps)


def test_new_objects_are_picked_up_on_the_way():
    truth = [*sliding(STRETCH, (3,)), *sliding(2 * STRETCH + 1)[STRETCH:]]
    maps, _ = tracked(scripted(truth), len(truth))
    assert [len(labels.unique()) - 1 for labels in maps] == [1] * STRETCH + [2] * (STRETCH + 1)
    first, last = maps[0], maps[-1]
    assert first[truth[0] == 3].unique().equal(last[truth[-1] == 3].unique())


def test_what_one_photo_of_three_shows_gets_no_id():
    truth = sliding(STRETCH + 1)
    ghost = {row: {3, 7} if row == 1 else {3} for row in range(STRETCH + 1)}
    maps, state = tracked(scripted(truth, ghost), STRETCH + 1)
    assert state.next_id == 2 and all(labels.max() == 1 for labels in maps)


def test_photos_with_nothing_in_them():
    nothing = [torch.zeros(40, 120, dtype=torch.int64)] * 8
    maps, state = tracked(scripted(nothing), 8)
    assert not any(labels.any() for labels in maps) and state.next_id == 1
    truth = [*nothing[:STRETCH], *sliding(STRETCH + 2)]
    maps, _ = tracked(scripted(truth), len(truth))
    assert not maps[STRETCH - 1].any() and len(maps[-1].unique()) == 3


def test_one_photo_alone():
    maps, state = tracked(scripted(sliding(1)), 1)
    assert len(maps[0].unique()) == 3 and state.next_id == 3


def test_ids_are_not_reused_after_photos_of_another_size():
    truth = sliding(3)
    turned = [labels.T.contiguous() for labels in truth]
    _, state = track([0, 1, 2], State(), scripted(truth))
    maps, state = track([0, 1, 2], state, scripted(turned))
    assert maps[0].unique().tolist() == [0, 3, 4] and state.next_id == 5
    assert maps[2].shape == turned[0].shape

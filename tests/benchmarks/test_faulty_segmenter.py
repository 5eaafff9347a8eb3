from dataclasses import replace

import torch
from faulty_segmenter import Mistakes, faulty_segmenter
from right_ids import right_ids

from balls import BALLS, CAMERAS, SPLATS
from stylesplat.demo.faults import FaultConfig
from stylesplat.masks.repair import repair_ids
from stylesplat.masks.tracking import (
    Segmenter,
    TrackingState,
    labels_to_masks,
    masks_to_labels,
    split_clips,
    track_clip,
)
from stylesplat.selection.identities import render_labels

TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]
NONE = Mistakes(FaultConfig(0.0, 0.0, 0.0, 0.0), halved=0.0, lost=0.0, swapped=0.0)
ROWS = [0, 1, 2, 3]
ROWS8 = range(8)


def masks(row: int) -> dict[int, torch.Tensor]:
    return labels_to_masks(TRUTH[row])


def same(some, others) -> bool:
    return len(some) == len(others) and all(map(torch.equal, some, others))


def test_without_mistakes_it_is_the_truth():
    segmenter = faulty_segmenter(TRUTH, mistakes=NONE)
    assert segmenter.size(0) == (36, 48)
    assert same(segmenter.propose(2), [*masks(2).values()])
    for row, found in zip(ROWS, segmenter.propagate(ROWS, masks(0)), strict=True):
        assert {*found} == {*BALLS} and same([*found.values()], [*masks(row).values()])


def test_the_same_seed_makes_the_same_mistakes():
    one, again, other = (faulty_segmenter(TRUTH, seed=seed) for seed in (1, 1, 2))
    assert all(same(one.propose(row), again.propose(row)) for row in range(8))
    assert not all(same(one.propose(row), other.propose(row)) for row in range(8))
    followed = (
        [masks_to_labels(f, (36, 48)) for f in s.propagate(ROWS, masks(0))] for s in (one, again)
    )
    assert same(*followed)


def test_halves_make_up_the_object():
    segmenter = faulty_segmenter(TRUTH, mistakes=replace(NONE, halved=1.0))
    halves = segmenter.propose(1)
    assert len(halves) == 2 * len(BALLS)
    wholes = [left | right for left, right in zip(halves[::2], halves[1::2], strict=True)]
    assert same(wholes, [*masks(1).values()])


def test_what_is_lost_stays_lost():
    rows = [*range(8)]
    segmenter = faulty_segmenter(TRUTH, mistakes=replace(NONE, lost=4.0))  # every second step
    counts = [len(found) for found in segmenter.propagate(rows, masks(0))]
    assert counts[0] == 3 and counts[-1] < 3 and counts == sorted(counts, reverse=True)


def test_what_is_swapped_goes_on_with_another_object():
    rows = [*range(8)]
    segmenter = faulty_segmenter(TRUTH, mistakes=replace(NONE, swapped=4.0))
    wrong = 0
    for row, found in zip(rows, segmenter.propagate(rows, masks(0)), strict=True):
        for id, mask in found.items():
            objects = TRUTH[row][mask].unique().tolist()
            assert len(objects) == 1 and objects[0] in BALLS
            wrong += objects != [id]
    assert wrong


def test_a_part_stands_for_its_object_and_a_union_for_both():
    segmenter = faulty_segmenter(TRUTH, mistakes=NONE)
    one, two, three = masks(0).values()
    columns = torch.arange(48) < int(one.nonzero()[:, 1].float().mean())
    (_, part), (_, union), (_, nothing) = (
        segmenter.propagate([0, 1], {9: seed}) for seed in (one & columns, one | two, one & ~one)
    )
    exact = [*masks(1).values()]
    assert part[9].equal(exact[0]) and union[9].equal(exact[0] | exact[1]) and not nothing
    assert three.any()


def tracked(segmenter: Segmenter) -> list[torch.Tensor]:
    state, maps = TrackingState(), {}
    for rows in split_clips(CAMERAS):
        found, state = track_clip(rows, state, segmenter)
        maps |= found
    return [maps[row] for row in range(len(CAMERAS))]


def test_repair_mends_what_tracking_left():
    mistakes = Mistakes(FaultConfig(8.0, missing=0.05, merged=0.1, fragments=0.2), halved=0.05)
    plain = replace(SPLATS, identities=None, classifier=None)
    scores = []
    for seed in range(6):
        segmenter = faulty_segmenter(TRUTH, seed=seed, mistakes=mistakes)
        single = [
            masks_to_labels(dict(enumerate(segmenter.propose(row), 1)), (36, 48)) for row in ROWS8
        ]
        maps = tracked(segmenter)
        stages = (single, maps, repair_ids(plain, CAMERAS, maps))
        scores.append([right_ids(each, TRUTH).right_pixels for each in stages])
    single, between, after = (sum(each) / len(each) for each in zip(*scores, strict=True))
    assert single < between < 0.95 < after  # what is left are borders of a pixel

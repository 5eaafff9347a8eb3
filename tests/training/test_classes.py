import weakref
from dataclasses import replace

import pytest
import torch

from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import ids_of
from stylesplat.scene.lazy import Lazy
from stylesplat.training.classes import (
    Shown,
    class_type,
    say_unseen,
    shown_ids,
    to_classes,
)


def labelled(capture: Capture, *maps: list[int] | None) -> Capture:
    """One row of labels per photo, photos without repeated."""
    filled = [*maps, *[None] * (len(capture) - len(maps))]
    tensors = [None if ids is None else torch.tensor([ids]) for ids in filled]
    return replace(capture, label_maps=tensors)


def test_ids_that_occur_background_first(capture: Capture):
    assert shown_ids(capture, range(9)) == Shown((0, 3, 7), {})


def test_background_is_a_class_even_if_nobody_drew_it(capture: Capture):
    assert shown_ids(labelled(capture, [5, 5]), range(9)).trained == (0, 5)


def test_ids_of_trained_photos_only(capture: Capture):
    maps = labelled(capture, [1, 2], [2, 3], [4, 0], [5])
    shown = shown_ids(maps, [1, 3])
    assert shown.trained == (0, 2, 3, 5)
    assert shown.held_out == {"0.png": (1,), "2.png": (4,)}


def test_without_label_maps_there_are_no_classes(capture: Capture):
    assert shown_ids(replace(capture, label_maps=None), range(9)) == Shown((), {})
    assert shown_ids(labelled(capture), range(9)) == Shown((), {})


def test_maps_of_nothing_but_background_make_one_class(capture: Capture):
    assert shown_ids(labelled(capture, [0, 0]), range(9)) == Shown((0,), {})


def test_only_one_map_is_held_at_a_time(capture: Capture):
    maps: list[weakref.ref] = []

    def make() -> torch.Tensor:
        fresh = torch.zeros(4, 4, dtype=torch.int32)
        maps.append(weakref.ref(fresh))
        alive.append(sum(each() is not None for each in maps))
        return fresh

    alive: list[int] = []
    lazy = replace(capture, label_maps=Lazy([make] * 9))
    alive.clear()
    shown_ids(lazy, range(9))
    assert len(alive) == 9 and max(alive) <= 2  # the last one until the next has come


@pytest.mark.parametrize("high", [9, 70_000, 2**24 - 1])
def test_ids_of_a_map(high: int):
    labels = torch.tensor([[0, 4, high], [high, 4, 4]], dtype=torch.int32)
    assert ids_of(labels) == {0, 4, high}
    assert ids_of(labels.long()) == {0, 4, high}


def test_ids_of_no_map():
    assert ids_of(None) == set() == ids_of(torch.zeros(0, 3, dtype=torch.int32))


def test_classes_are_places_in_the_ids():
    ids = (0, 3, 7, 300, 70_000)
    labels = torch.tensor([[70_000, 0, 3], [7, 300, 3]])
    classes = to_classes(labels, ids)
    assert torch.equal(torch.tensor(ids)[classes.long()], labels)


@pytest.mark.parametrize(
    ("count", "dtype"),
    [(1, torch.uint8), (256, torch.uint8), (257, torch.int16), (40_000, torch.int32)],
)
def test_the_smallest_type_holds_all_classes(count: int, dtype: torch.dtype):
    assert class_type(count) == dtype
    ids = tuple(range(0, 2 * count, 2))
    classes = to_classes(torch.tensor([[0, ids[-1]]]), ids)
    assert classes.dtype == dtype and classes.tolist() == [[0, count - 1]]


def test_nothing_is_said_if_all_is_learned(said: list[str]):
    say_unseen(Shown((0, 3), {}), {})
    assert said == []


def test_what_is_not_learned_is_said_in_one_line(said: list[str]):
    held_out = {f"{i}.png": (i, 9) for i in range(5)}
    say_unseen(Shown((0,), held_out), {2: "vase"})
    assert said == [
        "Not learned, for only held-out photos show it: object 0, 1, 2 (vase) and 3 more in "
        "0.png, 1.png, 2.png and 2 more. `--test-every 0` trains on all photos, another value "
        "holds out others."
    ]

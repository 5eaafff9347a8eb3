"""Nouns that hold tensors are compared by identity."""

from dataclasses import replace

import torch

from balls import CAMERAS, RED, SPLATS, TRAINED
from scenes import layer_towards
from stylesplat.scene.capture import Capture
from stylesplat.scene.sequences import cached_while_alive
from stylesplat.scene.splats import Splats


def test_nouns_are_equal_to_themselves_alone():
    layer = layer_towards(SPLATS, SPLATS, RED, "red")
    capture = Capture(CAMERAS, [torch.zeros(36, 48, 3, dtype=torch.uint8)] * len(CAMERAS))
    nouns = SPLATS, SPLATS.classifier, CAMERAS, TRAINED, TRAINED.objects["red"], layer, capture
    for noun in nouns:
        assert noun is not None
        other = replace(noun)
        assert noun != other and len({noun, other}) == 2
        assert [other, noun].index(noun) == 1


def test_a_cached_result_belongs_to_the_last_arguments():
    made = list[int]()

    @cached_while_alive
    def count(splats: Splats, other: object) -> int:
        made.append(len(splats))
        return len(made)

    assert [count(SPLATS, CAMERAS), count(SPLATS, CAMERAS), count(SPLATS, TRAINED)] == [1, 1, 2]
    assert [count(replace(SPLATS), TRAINED), count(SPLATS, TRAINED)] == [3, 4]

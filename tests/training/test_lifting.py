from dataclasses import replace

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import render_labels
from stylesplat.selection.pick import pick_objects
from stylesplat.training.lifting import class_codes, lift

PLAIN = replace(SPLATS, identities=None, classifier=None)
PHOTOS = [torch.zeros(36, 48, 3, dtype=torch.uint8)] * len(CAMERAS)
TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]


def capture(label_maps) -> Capture:
    return Capture(cameras=CAMERAS, photos=PHOTOS, label_maps=label_maps)


def agreement(splats: Splats) -> float:
    maps = [render_labels(splats, CAMERAS[row]) for row in range(len(CAMERAS))]
    return float((torch.stack(maps) == torch.stack(TRUTH)).float().mean())


def test_objects_come_back():
    lifted = lift(PLAIN, capture(TRUTH))
    assert agreement(lifted) > 0.97
    known, found = pick_objects(SPLATS, [*BALLS]), pick_objects(lifted, [*BALLS])
    for id, mask in known.items():
        assert (mask & found[id]).sum() / (mask | found[id]).sum() > 0.7  # undersides are hidden
    assert lifted.confidence is not None and lifted.confidence.max() <= 1 + 1e-5
    hidden = replace(PLAIN, means=PLAIN.means.index_fill(0, torch.tensor([5]), 99.0))
    unseen = lift(hidden, capture(TRUTH)).confidence
    assert unseen is not None and unseen[5] == 0


def test_only_identities_are_new():
    lifted = lift(PLAIN, capture(TRUTH))
    for name, values in PLAIN.tensors().items():
        assert torch.equal(values, lifted.tensors()[name])


def test_other_views_outvote_a_wrong_map():
    wrong = [labels.clone() for labels in TRUTH]
    wrong[2] = torch.where(wrong[2] == 3, 7, wrong[2])  # two balls merged
    wrong[5] = torch.zeros_like(wrong[5])  # all lost
    assert agreement(lift(PLAIN, capture(wrong))) > 0.95


def test_views_without_a_map_and_views_left_out():
    some = [labels if row % 2 else None for row, labels in enumerate(TRUTH)]
    with_gaps = lift(PLAIN, capture(some))
    chosen = lift(PLAIN, capture(TRUTH), rows=range(1, len(TRUTH), 2))
    assert with_gaps.identities is not None and chosen.identities is not None
    assert torch.equal(with_gaps.identities, chosen.identities)


def test_more_classes_than_numbers_per_gaussian():
    strips = [torch.arange(36)[:, None].expand(36, 48) + 100 for _ in TRUTH]  # 36 classes
    lifted = lift(PLAIN, capture(strips))
    assert lifted.classifier is not None
    assert len(lifted.classifier.ids) == 37  # and background
    codes = class_codes(37)
    closeness = (codes @ codes.T).fill_diagonal_(-1)
    assert closeness.max() < 0.75
    assert torch.equal(class_codes(37), codes)


def test_codes_of_few_classes_do_not_mix():
    codes = class_codes(16)
    assert torch.equal(codes @ codes.T, torch.eye(16))


def test_nothing_to_lift():
    with pytest.raises(StyleSplatError, match="no label maps to lift"):
        lift(PLAIN, capture(None))
    away = replace(PLAIN, means=PLAIN.means + 1000)
    with pytest.raises(StyleSplatError, match="share a world frame"):
        lift(away, capture(TRUTH))

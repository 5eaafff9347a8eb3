from dataclasses import replace

import pytest
import torch
from scipy.sparse import csr_array

from balls import BALLS, CAMERAS, PLAIN, SPLATS, class_probabilities
from stylesplat.errors import StyleSplatError
from stylesplat.scene import splats as nouns
from stylesplat.scene.capture import Capture
from stylesplat.scene.selection import THRESHOLD
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import each_object, render_labels
from stylesplat.training import lifting
from stylesplat.training.lifting import REPULSIONS, class_codes, labelled, lift, with_labels_of

PHOTOS = [torch.zeros(36, 48, 3, dtype=torch.uint8)] * len(CAMERAS)
TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]


def capture(label_maps) -> Capture:
    return Capture(cameras=CAMERAS, photos=PHOTOS, label_maps=label_maps)


def agreement(splats: Splats) -> float:
    maps = [render_labels(splats, CAMERAS[row]) for row in range(len(CAMERAS))]
    return float((torch.stack(maps) == torch.stack(TRUTH)).float().mean())


def test_objects_come_back_and_only_identities_are_new():
    lifted = lift(PLAIN, capture(TRUTH))
    assert agreement(lifted) > 0.97
    known, found = (dict(each_object(each, [*BALLS])) for each in (SPLATS, lifted))
    for id, mask in known.items():
        assert (mask & found[id]).sum() / (mask | found[id]).sum() > 0.7  # undersides are hidden
    for name, values in PLAIN.tensors().items():
        assert torch.equal(values, lifted.tensors()[name])
    assert lifted.confidence is not None and lifted.confidence.max() <= 1 + 1e-5
    hidden = replace(PLAIN, means=PLAIN.means.index_fill(0, torch.tensor([5]), 99.0))
    unseen = lift(hidden, capture(TRUTH)).confidence
    assert unseen is not None and unseen[5] == 0


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


@pytest.mark.parametrize("count", [16, 17, 300, 1000])
def test_labels_are_distinct_however_many_there_are(monkeypatch, count: int):
    """Gaussians of which seven tenths are one label's, the rest two others'."""
    monkeypatch.setattr(lifting, "REPULSIONS", min(REPULSIONS, 20_000 // count))  # fast
    generator, rows = torch.Generator().manual_seed(0), torch.arange(len(PLAIN))
    own, one, other = torch.randint(count, (3, len(PLAIN)), generator=generator)
    table = torch.zeros(len(PLAIN), count)
    for labels, pixels in ((own, 70), (one, 10), (other, 20)):
        table[rows, labels] += pixels
    monkeypatch.setattr(lifting, "label_pixels", lambda *_: (tuple(range(count)), csr_array(table)))
    found = class_probabilities(lift(PLAIN, capture(TRUTH)))
    most = table.max(dim=1)
    sure = most.values > 65  # where both others are one, a little closer to it
    assert sure.all() and (found[rows, most.indices] > THRESHOLD).float().mean() > 0.98


def test_labels_on_top_of_others_are_those_of_whole_tables(monkeypatch):
    """Some of new ids, one in the place of an earlier one; looked at a few rows at a time."""
    earlier = lift(PLAIN, capture(TRUTH))
    halves = [torch.where(torch.arange(48) < 24, labels, 0) for labels in TRUTH]
    newer, renamed = lift(PLAIN, capture(halves)), {3: 7, 7: 301, 300: 302}
    before, after = class_probabilities(earlier), class_probabilities(newer)
    shares, ids = torch.zeros(len(PLAIN), 6), (0, 3, 7, 300, 301, 302)
    for column, id in enumerate((0, 3, 0, 300)):  # 7 gives way
        shares[:, ids.index(id)] += after[:, 0] * before[:, column]
    for column, id in enumerate((3, 7, 300), start=1):
        shares[:, ids.index(renamed[id])] += after[:, column]
    monkeypatch.setattr(nouns, "AT_ONCE", 40)
    found = with_labels_of(earlier, newer, renamed)
    assert found.classifier is not None and found.classifier.ids == ids
    assert found.identities is not None
    # float32 in another order
    torch.testing.assert_close(found.identities, shares @ class_codes(6), atol=1e-5, rtol=0)


def test_nothing_to_lift():
    with pytest.raises(StyleSplatError, match="no label maps to lift"):
        lift(PLAIN, capture(None))
    away = replace(PLAIN, means=PLAIN.means + 1000)
    with pytest.raises(StyleSplatError, match="share a world frame"):
        lift(away, capture(TRUTH))


def test_known_labels_leave_no_doubt():
    labels = torch.arange(len(PLAIN)) % 4 * 5
    most = class_probabilities(labelled(PLAIN, labels)).max(dim=1)
    assert torch.equal(most.indices, labels // 5) and most.values.min() > 0.98
    with pytest.raises(StyleSplatError, match="labels for"):
        labelled(PLAIN, labels[1:])
    with pytest.raises(StyleSplatError, match="objects in labels from"):
        labelled(PLAIN, 0 * labels)


def test_pixels_that_are_masked_out_have_no_label():
    right = torch.arange(48).expand(36, 48) >= 24
    wrong = [labels.where(~right, 99) for labels in TRUTH]
    masked = replace(capture(wrong), valid_masks=[~right] * len(TRUTH))
    lifted = lift(PLAIN, masked)
    assert lifted.classifier is not None and 99 not in lifted.classifier.ids
    nothing = replace(capture(TRUTH), valid_masks=[torch.zeros(36, 48, dtype=torch.bool)] * 8)
    with pytest.raises(StyleSplatError, match="None of the Gaussians"):
        lift(PLAIN, nothing)

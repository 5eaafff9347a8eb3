from dataclasses import replace

import pytest
import torch

from balls import SPLATS
from stylesplat.scene import splats as nouns
from stylesplat.selection.identities import class_probabilities
from stylesplat.selection.members import likeliest, members
from stylesplat.selection.pick import pick, pick_objects

IDS = (3, 7, 300)


@pytest.fixture
def doubtful(monkeypatch: pytest.MonkeyPatch):
    """Identities with noise, looked at a few at a time."""
    monkeypatch.setattr(nouns, "AT_ONCE", 12)  # three Gaussians of four classes
    noise = torch.randn(len(SPLATS), 16, generator=torch.Generator().manual_seed(0))
    assert SPLATS.identities is not None
    return replace(SPLATS, identities=SPLATS.identities + 0.4 * noise)


@pytest.mark.parametrize("threshold", [0.1, 0.5, 0.8])
def test_as_the_whole_table_says(doubtful, threshold: float):
    table, ids = class_probabilities(doubtful), (0, *IDS)
    found = members(doubtful, IDS, threshold)
    for id in IDS:
        own = table[:, ids.index(id)]
        limits = torch.tensor([threshold if each == id else 0.5 for each in ids])
        limits[0] = 0.9
        assert torch.equal(found.mask(id), own > threshold)
        rows = torch.arange(0, len(table), 2)
        assert torch.equal(found.doubtful(id, rows), (table <= limits).all(dim=1)[rows])
    assert torch.equal(likeliest(doubtful), torch.tensor(ids)[table.argmax(dim=1)])


@pytest.mark.parametrize("threshold", [0.0, 0.1, 0.5, 0.8, 1.0])
def test_what_is_surely_background_is_not_looked_at(doubtful, threshold: float):
    one, all_of_them = (members(doubtful, ids, threshold) for ids in ((3,), IDS))
    assert torch.equal(one.likely[3], all_of_them.likely[3])
    assert torch.equal(one.vouched[3], all_of_them.vouched[3])


def test_objects_of_one_pass_are_those_of_many(doubtful):
    together = pick_objects(doubtful, IDS)
    for id in IDS:
        assert torch.equal(together[id], pick(doubtful, object_id=id))

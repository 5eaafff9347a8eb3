"""Intermediate results of `mask` that are damaged: they are found again, or refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.masks.checkpoint import open_checkpoint
from stylesplat.masks.tracking import TrackingState


@pytest.mark.parametrize(
    ("shape", "width", "kept"),
    [((1, 4, 1), 8, 60), ((1, 4, 1), 10**12, None), ((1, 5, 1), 8, None), ((4, 1), 7, None)],
)
def test_damaged_proposals_are_found_again(
    shape: tuple[int, ...], width: int, kept: int | None, tmp_path: Path
):
    checkpoint = open_checkpoint(tmp_path / "run", {"sizes": [[8, 4]]})
    path = tmp_path / "run" / "proposals_0.npz"
    np.savez_compressed(path, bits=np.zeros(shape, np.uint8), width=width)
    path.write_bytes(path.read_bytes()[:kept])
    found = torch.ones(4, 8, dtype=torch.bool)
    (mask,) = checkpoint.proposals(0, lambda: [found])
    assert torch.equal(mask, found)
    (again,) = checkpoint.proposals(0, lambda: pytest.fail("asked again"))
    assert torch.equal(again, found)


@pytest.mark.parametrize(
    "change", [{"clips": -1}, {"next_id": 2**70}, {"missed": {"x": 1}}], ids=str
)
def test_a_damaged_state_begins_anew(change: dict, tmp_path: Path, said: list[str]):
    checkpoint = open_checkpoint(tmp_path / "run", {})
    labels = torch.ones(4, 8, dtype=torch.int64)
    checkpoint.save(1, {0: labels}, TrackingState(labels, {1: 0}, 2))
    assert checkpoint.load()[0] == 1
    content = json.loads((tmp_path / "run" / "state.json").read_text())
    (tmp_path / "run" / "state.json").write_text(json.dumps(content | change))
    assert checkpoint.load() == (0, TrackingState())
    assert len(said) == 1 and "damaged" in said[0]


def test_label_maps_of_another_size_are_refused(tmp_path: Path):
    checkpoint = open_checkpoint(tmp_path / "run", {"sizes": [[8, 4]]})
    checkpoint.save(1, {0: torch.ones(4, 9, dtype=torch.int64)}, TrackingState())
    with pytest.raises(StyleSplatError, match=r"labels_0\.png is of another size .* Delete"):
        checkpoint.labels(0)


@pytest.mark.parametrize("left", [[".settings.0123456789ab.json"], ["labels_3.png", "x.json"]])
def test_a_folder_that_a_kill_left_without_settings(left: list[str], tmp_path: Path):
    folder = tmp_path / "object_mask.partial"
    folder.mkdir()
    for name in left:
        (folder / name).touch()
    if "x.json" in left:
        with pytest.raises(StyleSplatError, match="in the way"):
            open_checkpoint(folder, {})
        assert sorted(path.name for path in folder.iterdir()) == left
    else:
        open_checkpoint(folder, {})
        assert [path.name for path in folder.iterdir()] == ["settings.json"]

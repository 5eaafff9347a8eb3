"""What an earlier run of `mask` left, damaged: it is found again, or refused in one line."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.masks.checkpoint import open_checkpoint
from stylesplat.masks.tracking import TrackingState


def zeros(width: int, shape: tuple[int, ...] = (1, 4, 1), kind: type = np.uint8) -> bytes:
    """A file of masks, or of what is none."""
    file = io.BytesIO()
    np.savez_compressed(file, bits=np.zeros(shape, kind), width=width)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK\x03\x04",
        zeros(8)[:100],
        zeros(10**12),
        zeros(-3),
        zeros(7, (4, 1)),
        zeros(7, kind=np.int32),
        zeros(8, (1, 5, 1)),
        zeros(8, (1, 2**14, 2**14)),
    ],
    ids=range(9),
)
def test_damaged_proposals_are_asked_again(content: bytes, tmp_path: Path):
    progress = open_checkpoint(tmp_path / "run", {"sizes": [[8, 4]]})
    (tmp_path / "run" / "proposals_0.npz").write_bytes(content)
    found = torch.ones(4, 8, dtype=torch.bool)
    (mask,) = progress.proposals(0, lambda: [found])
    assert torch.equal(mask, found)
    assert len(progress.proposals(0, lambda: pytest.fail("asked again"))) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"clips": "1"},
        {"clips": -1},
        {"next_id": 2**70},
        {"next_id": None},
        {"missed": {"x": 1}},
        {"missed": {"1": -1}},
        {"missed": [1]},
    ],
    ids=str,
)
def test_a_damaged_state_begins_anew(change: dict, tmp_path: Path, said: list[str]):
    progress = open_checkpoint(tmp_path / "run", {})
    labels = torch.ones(4, 8, dtype=torch.int64)
    progress.save(1, {0: labels}, TrackingState(labels, {1: 0}, 2))
    assert progress.load()[0] == 1
    content = json.loads((tmp_path / "run" / "state.json").read_text())
    (tmp_path / "run" / "state.json").write_text(json.dumps(content | change))
    assert progress.load() == (0, TrackingState())
    assert said == ["What an earlier run left is damaged; tracking begins anew."]


def test_label_maps_of_another_size_are_refused(tmp_path: Path):
    progress = open_checkpoint(tmp_path / "run", {"sizes": [[8, 4]]})
    progress.save(1, {0: torch.ones(4, 9, dtype=torch.int64)}, TrackingState())
    with pytest.raises(StyleSplatError, match=r"labels_0\.png is of another size .* Delete"):
        progress.labels(0)


@pytest.mark.parametrize("left", [[], [".settings.0123456789ab.json"], ["labels_3.png", "x.json"]])
def test_a_folder_that_a_kill_left_without_settings(left: list[str], tmp_path: Path):
    """They are the first that is written, and may be the first that is deleted."""
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

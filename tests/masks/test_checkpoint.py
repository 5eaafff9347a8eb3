"""Intermediate results of `mask` that are damaged: they are found again, or refused in one line."""

from pathlib import Path

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.masks.from_model import open_checkpoint
from stylesplat.masks.tracking import TrackingState

SETTINGS = {"clips": [[0, 1], [1, 2]], "sizes": [[8, 4]] * 3}


def labels(id: int, width: int = 8) -> torch.Tensor:
    return torch.full((4, width), id)


def test_clips_are_as_they_were_saved_up_to_one_that_is_damaged(tmp_path: Path, said: list[str]):
    checkpoint = open_checkpoint(tmp_path / "run", SETTINGS)
    first = {0: labels(1), 1: labels(2)}, TrackingState(labels(2), {2: 1}, 3)
    second = {1: labels(2), 2: labels(2)}, TrackingState(labels(2), {}, 3)
    for clip, (maps, state) in enumerate((first, second)):
        checkpoint.save(clip, maps, state)
    for (maps, state), (wanted, after) in zip(checkpoint.load(), (first, second), strict=True):
        assert all(torch.equal(maps[row], wanted[row]) for row in wanted)
        assert (state.missed, state.next_id) == (after.missed, after.next_id)
        assert state.known is not None and torch.equal(state.known, labels(2))
    path = tmp_path / "run" / "clip_1.npz"
    path.write_bytes(path.read_bytes()[:60])
    assert len(list(checkpoint.load())) == 1 and "damaged" in said[0]
    checkpoint.save(0, {0: labels(1), 1: labels(1, width=9)}, TrackingState())
    assert not list(checkpoint.load()), "of another size than its photo"


@pytest.mark.parametrize("left", [[".settings.0123456789ab.json"], ["clip_3.npz", "x.json"]])
def test_a_folder_that_a_kill_left_without_settings(left: list[str], tmp_path: Path):
    folder = tmp_path / "object_mask.partial"
    folder.mkdir()
    for name in left:
        (folder / name).touch()
    if "x.json" in left:
        with pytest.raises(StyleSplatError, match="in the way"):
            open_checkpoint(folder, SETTINGS)
        assert sorted(path.name for path in folder.iterdir()) == left
    else:
        open_checkpoint(folder, SETTINGS)
        assert [path.name for path in folder.iterdir()] == ["settings.json"]

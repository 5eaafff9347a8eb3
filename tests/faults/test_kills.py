"""Kills: what is on disk is the old or the new, and the next one who comes cleans up."""

import os
from pathlib import Path

import pytest

from killing import WRITERS, faults, kills

LEAST = {"export": 6, "checkpoint": 3, "views": 15}  # calls at which a writer can be killed
USUAL = 20  # of the others


@pytest.fixture
def no_fsync(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes long, and only power cuts need it."""
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.mark.parametrize("name", WRITERS)
def test_a_kill_leaves_the_old_or_the_new(name: str, tmp_path: Path, no_fsync: None):
    writer, folder = WRITERS[name], tmp_path / "work"
    folder.mkdir()
    writer.prepare(folder)
    whole = [writer.read(folder)]
    left = kills(writer.write, folder, tmp_path / "kills")
    whole.append(writer.read(folder))
    assert whole[0] != whole[1]
    assert len(left) >= LEAST.get(name, USUAL), "the calls were not seen"
    wrong = {place.name: found for place in left if (found := faults(writer, place, whole))}
    assert not wrong

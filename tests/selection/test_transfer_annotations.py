"""Gaussians found again after other programs had them."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from scipy.spatial.transform import Rotation

from scenes import joined, random_splats
from stylesplat.io.splats.splat_files import read_splats, row_order, write_splats
from stylesplat.scene.frames import FRAME_SAME, Frame, move_splats
from stylesplat.selection.transfer import match_gaussians

KNOWN = replace(random_splats(600), identities=None)  # plain, as files have them
TURN = torch.from_numpy(Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix())
FRAME = Frame(TURN, 1.7, torch.tensor([1.0, -2.0, 0.5]).double())
SOME = torch.randperm(600, generator=torch.Generator().manual_seed(0))[:400]


def test_rows_that_are_missing_and_in_another_order():
    frame, rows = match_gaussians(KNOWN[SOME], KNOWN)
    assert torch.equal(rows, SOME) and frame is FRAME_SAME


def test_a_motion_of_everything_is_found():
    new = replace(random_splats(50, seed=7), identities=None)
    frame, rows = match_gaussians(joined(move_splats(KNOWN[SOME], FRAME), new), KNOWN)
    assert torch.equal(rows[:400], SOME) and (rows[400:] >= 0).sum() <= 2
    assert frame.scale == pytest.approx(1.7, abs=1e-5) and frame.shift is not None
    torch.testing.assert_close(frame.rotation, TURN, atol=1e-5, rtol=0)
    torch.testing.assert_close(frame.shift, FRAME.shift, atol=1e-4, rtol=0)


def test_a_part_that_was_moved_is_new():
    moved_part = move_splats(KNOWN[SOME[300:]], FRAME)
    frame, rows = match_gaussians(joined(KNOWN[SOME[:300]], moved_part), KNOWN)
    assert frame is FRAME_SAME and torch.equal(rows[:300], SOME[:300])
    assert (rows[300:] >= 0).sum() <= 2


def test_colours_may_have_been_changed():
    other = replace(KNOWN, sh0=torch.rand(600, 1, 3), shN=torch.zeros(600, 0, 3))
    for found in (other, move_splats(other, FRAME)):
        assert (match_gaussians(found, KNOWN)[1] == torch.arange(600)).float().mean() > 0.99


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".spz", ".splat", ".sog", ".glb"])
def test_formats_that_round(suffix: str, tmp_path: Path):
    path = tmp_path / f"a{suffix}"
    write_splats(KNOWN, path)
    for found in (read_splats(path), move_splats(read_splats(path), FRAME)):
        _, rows = match_gaussians(found, KNOWN)
        assert (rows == row_order(KNOWN, path)).float().mean() > 0.97


def test_many_copies_at_one_place(tmp_path: Path):
    copies = KNOWN[torch.cat([torch.arange(600), torch.full((40,), 7)])]
    write_splats(copies, tmp_path / "a.glb")
    _, rows = match_gaussians(read_splats(tmp_path / "a.glb"), copies)
    assert torch.equal(rows.sort().values, torch.arange(640))


def test_another_splat_has_none_of_them():
    other = replace(random_splats(300, seed=5), identities=None)
    assert (match_gaussians(other, KNOWN)[1] >= 0).sum() < 3
    far = replace(KNOWN, opacities=-KNOWN.opacities, scales=KNOWN.scales.flip(0) + 2)
    assert (match_gaussians(far, KNOWN)[1] >= 0).float().mean() < 0.1

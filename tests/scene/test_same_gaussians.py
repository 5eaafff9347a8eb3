"""Gaussians found again after other programs had them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from scenes import random_splats
from stylesplat.io.splats.splat_files import read_splats, row_order, write_splats
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.same_gaussians import match_gaussians, similarity_of
from stylesplat.scene.splats import Splats

KNOWN = replace(random_splats(600), identities=None)  # plain, as files have them
TURN = torch.from_numpy(Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix())
FRAME = Frame(TURN, 1.7, torch.tensor([1.0, -2.0, 0.5]).double())
SOME = torch.randperm(600, generator=torch.Generator().manual_seed(0))[:400]


def test_rows_that_are_missing_and_in_another_order():
    match = match_gaussians(KNOWN[SOME], KNOWN)
    assert torch.equal(match.rows, SOME)
    ((frame, mask),) = match.parts
    assert mask.all() and frame.shift is None


def test_a_motion_of_everything_is_found():
    match = match_gaussians(move_splats(KNOWN[SOME], FRAME), KNOWN)
    assert torch.equal(match.rows, SOME)
    ((frame, mask),) = match.parts
    assert mask.all() and frame.scale == pytest.approx(1.7, abs=1e-5)
    torch.testing.assert_close(frame.rotation, TURN, atol=1e-5, rtol=0)


def test_new_gaussians_are_none_of_the_scene():
    new = replace(random_splats(50, seed=7), identities=None)
    match = match_gaussians(Splats.cat([move_splats(KNOWN[SOME], FRAME), new]), KNOWN)
    assert torch.equal(match.rows[:400], SOME)
    assert (match.rows[400:] >= 0).sum() <= 2


def test_colours_may_have_been_changed():
    other = replace(KNOWN, sh0=torch.rand(600, 1, 3), shN=torch.zeros(600, 0, 3))
    for found in (other, move_splats(other, FRAME)):
        assert (match_gaussians(found, KNOWN).rows == torch.arange(600)).float().mean() > 0.99


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".spz", ".splat", ".sog", ".glb"])
def test_formats_that_round(suffix: str, tmp_path: Path):
    path = tmp_path / f"a{suffix}"
    write_splats(KNOWN, path)
    for found in (read_splats(path), move_splats(read_splats(path), FRAME)):
        match = match_gaussians(found, KNOWN)
        assert (match.rows == row_order(KNOWN, path)).float().mean() > 0.97
        assert len(match.parts) == 1


def test_many_copies_at_one_place(tmp_path: Path):
    copies = KNOWN[torch.cat([torch.arange(600), torch.full((40,), 7)])]
    write_splats(copies, tmp_path / "a.glb")
    rows = match_gaussians(read_splats(tmp_path / "a.glb"), copies).rows
    assert torch.equal(rows.sort().values, torch.arange(640))


def test_another_splat_has_none_of_them():
    other = replace(random_splats(300, seed=5), identities=None)
    assert not match_gaussians(other, KNOWN).parts
    far = replace(KNOWN, opacities=-KNOWN.opacities, scales=KNOWN.scales.flip(0) + 2)
    assert (match_gaussians(far, KNOWN).rows >= 0).float().mean() < 0.1


@pytest.mark.parametrize("count", [1, 3, 20])
def test_few_gaussians(count: int):
    few = KNOWN[torch.arange(count)]
    assert torch.equal(match_gaussians(few, KNOWN).rows, torch.arange(count))
    assert torch.equal(match_gaussians(few, few).rows, torch.arange(count))


def test_a_similarity_among_wrong_pairs():
    rng = np.random.default_rng(0)
    before = rng.normal(size=(200, 3))
    after = FRAME.place(torch.from_numpy(before)).numpy()
    after[80:] = rng.normal(size=(120, 3))
    found = similarity_of(before, after, 0.01)
    assert found is not None
    frame, fits = found
    assert fits[:80].all() and fits.sum() < 83
    torch.testing.assert_close(frame.rotation, TURN)
    assert similarity_of(before, rng.normal(size=(200, 3)), 1e-4) is None
    assert similarity_of(before[:3], after[:3], 1.0) is None


def test_no_mirror_image_is_a_similarity():
    before = np.random.default_rng(0).normal(size=(50, 3))
    found = similarity_of(before, before * [1, 1, -1], 10.0)
    assert found is not None and found[0].rotation.det() > 0

from dataclasses import replace

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import label_votes, render_shares
from stylesplat.selection.identities import render_labels

PLAIN = replace(SPLATS, identities=None, classifier=None)
TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]


def test_votes_are_the_pixels_that_show_a_gaussian():
    ids, votes = label_votes(PLAIN, CAMERAS, enumerate(TRUTH))
    assert ids == (0, *BALLS)
    alphas = sum(rasterize(PLAIN, CAMERAS[row])[1].sum() for row in range(len(CAMERAS)))
    assert votes.sum() == pytest.approx(float(alphas), rel=1e-4)


def test_more_labels_than_fit_in_one_pass():
    rows, columns = torch.meshgrid(torch.arange(36), torch.arange(48), indexing="ij")
    squares = 1 + rows // 6 * 8 + columns // 6  # 48 labels
    ids, votes = label_votes(PLAIN, CAMERAS, [(0, squares)])
    assert ids == tuple(range(49)) and not votes[:, 0].any()
    alphas = rasterize(PLAIN, CAMERAS[0])[1][0, ..., 0]
    for id in (1, 17, 48):
        assert votes[:, id].sum() == pytest.approx(float(alphas[squares == id].sum()), abs=1e-2)


def test_shares_are_rendered_in_any_number():
    shares = torch.rand(len(PLAIN), 20, generator=torch.Generator().manual_seed(0))
    shown = render_shares(PLAIN, CAMERAS[1], shares)
    assert shown.shape == (36, 48, 20)
    for column in (0, 15, 16, 19):
        one, _, _ = rasterize(PLAIN, CAMERAS[1], features=shares[:, column, None], sh_degree=0)
        torch.testing.assert_close(shown[..., column], one[0, ..., 3], atol=1e-4, rtol=0)

from collections.abc import Iterable
from dataclasses import replace

import pytest
import torch
from scipy.sparse import csr_array

from balls import BALLS, CAMERAS, PLAIN, SPLATS
from scenes import cloud, rand
from stylesplat.rendering import shares
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.shares import (
    colors_and_coverage,
    contributed,
    coverage,
    expected_depth,
    label_votes,
    largest_shown,
    render_shares,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import render_labels

TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]
PICKED = torch.arange(len(PLAIN)) % 3 == 0
ROUNDING = 1e-4  # float32 sums of the same weights in another order


def vote_table(
    splats: Splats, maps: Iterable[tuple[int, torch.Tensor]]
) -> tuple[tuple[int, ...], torch.Tensor]:
    ids, votes = label_votes(splats, CAMERAS, maps)
    return ids, torch.from_numpy(votes.toarray())


def test_votes_are_the_pixels_that_show_a_gaussian():
    ids, votes = vote_table(PLAIN, enumerate(TRUTH))
    assert ids == (0, *BALLS)
    alphas = sum(rasterize(PLAIN, CAMERAS[row])[1].sum() for row in range(len(CAMERAS)))
    assert votes.sum() == pytest.approx(float(alphas), rel=1e-4)


@pytest.mark.parametrize("side", [12, 6, 3])
def test_votes_of_many_labels_are_those_of_each_alone(side: int):
    """Of squares, 12, 48 or 192 in a view, that move from view to view, before a background."""
    rows, columns = torch.meshgrid(torch.arange(36), torch.arange(48), indexing="ij")
    squares = 1 + rows // side * (48 // side) + columns // side
    squares[:, 20:23] = 0
    maps = [squares.roll(5 * view, dims=1) + 1000 * (view % 2) for view in range(4)]
    ids, votes = vote_table(PLAIN, enumerate(maps))
    assert ids == (0, *torch.cat(maps).unique().tolist()[1:])
    for place, id in [*enumerate(ids)][:: len(ids) // 4]:
        alone = torch.zeros(len(PLAIN))
        for view, labels in enumerate(maps):
            wanted = (labels == id)[..., None].float().expand(-1, -1, 16)
            alone += contributed(PLAIN, CAMERAS[view], wanted.contiguous())[:, 0]
        torch.testing.assert_close(votes[:, place], alone, atol=1e-3, rtol=ROUNDING)


def test_the_largest_shown_is_that_of_all_shown():
    shares = rand(len(PLAIN), 40)
    shares *= shares > 0.8
    most, column = largest_shown(PLAIN, CAMERAS[1], csr_array(shares.numpy()))
    expected = render_shares(PLAIN, CAMERAS[1], shares).max(dim=-1)
    assert torch.equal(most, expected.values)
    covered = most > 0  # where nothing shows no column is larger than another
    assert torch.equal(column[covered], expected.indices[covered]) and column.max() >= 32


def test_shares_are_rendered_in_any_number():
    shares = rand(len(PLAIN), 20)
    shown = render_shares(PLAIN, CAMERAS[1], shares)
    assert shown.shape == (36, 48, 20)
    for column in (0, 15, 16, 19):
        one, _, _ = rasterize(PLAIN, CAMERAS[1], features=shares[:, column, None], sh_degree=0)
        torch.testing.assert_close(shown[..., column], one[0, ..., 3], atol=1e-4, rtol=0)


def test_contributed_is_the_transpose_of_the_render():
    generator = torch.Generator().manual_seed(0)
    carried, wanted = torch.rand(len(PLAIN), 16, generator=generator), torch.rand(36, 48, 16)
    image = rasterize(PLAIN, CAMERAS[2], features=carried, sh_degree=0)[0][0, ..., 3:]
    by_pixels = (image * wanted).sum()
    by_gaussians = (contributed(PLAIN, CAMERAS[2], wanted) * carried).sum()
    assert float(by_gaussians) == pytest.approx(float(by_pixels), rel=ROUNDING)


@pytest.mark.parametrize("row", range(2))
def test_in_a_large_scene_an_object_is_looked_for_where_it_may_show(
    row: int, monkeypatch: pytest.MonkeyPatch
):
    few = PICKED & (torch.arange(len(PLAIN)) < len(PLAIN) // 8)
    nobody = torch.zeros_like(few)
    whole = coverage(PLAIN, CAMERAS[row], few)
    monkeypatch.setattr(shares, "LARGE", 0)
    assert torch.equal(coverage(PLAIN, CAMERAS[row], few), whole) and whole.any()
    assert not coverage(PLAIN, CAMERAS[row], nobody).any()


def test_colors_come_with_their_coverage():
    image, share = colors_and_coverage(PLAIN, CAMERAS[0], PICKED)
    assert torch.equal(share[..., 0], coverage(PLAIN, CAMERAS[0], PICKED))
    plain = rasterize(PLAIN, CAMERAS[0])[0][0]
    torch.testing.assert_close(image, plain, atol=ROUNDING, rtol=0)


def wall(depth: float) -> tuple[Splats, Cameras]:
    """A dense wall of opaque Gaussians across the right half of a camera's view."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(0.1, 1, 20), indexing="ij")
    means = depth * torch.stack([x, y, torch.ones_like(x)], dim=-1).reshape(-1, 3)
    camera = replace(CAMERAS[0], viewmats=torch.eye(4)[None])
    return cloud(means, 0.05 * depth, opacity=6.0), camera


@pytest.mark.parametrize("depth", [0.5, 3.0, 40.0])
def test_the_expected_depth_of_a_wall_is_where_it_stands(depth: float):
    splats, camera = wall(depth)
    found, alphas = expected_depth(splats, camera)
    covered = alphas > 0.5
    assert 0.2 < covered.float().mean() < 0.8
    # the depth is an average of equal numbers: rounding
    assert (found[covered] - depth).abs().max() < 1e-4 * depth
    assert not found[alphas == 0].any() and (alphas == 0).any()

"""The loss, and the compressed search, which finds what the exhaustive one finds, or as good."""

import pytest
import torch
from torch.nn.functional import normalize

from scenes import randn
from stylesplat.stylization import matching
from stylesplat.stylization.matching import (
    build_index,
    cosine_distance,
    most_similar,
    nnfm_loss,
)

EXACT = 1e-6  # a few roundings of float32


def features(count: int, width: int = 96, *, seed: int, rank: int = 200) -> torch.Tensor:
    """Outputs of a random layer: non-negative, with principal directions as networks' have."""
    generator = torch.Generator().manual_seed(seed)
    layer = randn(rank, width, seed=99)
    spectrum = 1 / torch.arange(1, rank + 1).sqrt()
    return (torch.randn(count, rank, generator=generator) * spectrum @ layer + 0.2).relu()


def test_the_loss_is_the_distance_to_the_most_similar_row():
    feats, style = randn(20, 8, seed=0), randn(30, 8, seed=1)
    cosines = torch.cosine_similarity(feats[:, None], style[None], dim=-1)
    loss = nnfm_loss(feats, style)
    torch.testing.assert_close(loss, (1 - cosines.amax(dim=1)).mean())
    assert torch.equal(most_similar(feats, normalize(style)), cosines.argmax(dim=1))
    assert nnfm_loss(feats, feats) == pytest.approx(0, abs=EXACT)
    assert nnfm_loss(feats[:1], -feats[:1]) == pytest.approx(2, abs=EXACT)
    longer = style.flip(0) * torch.linspace(0.1, 9, 30)[:, None]
    torch.testing.assert_close(loss, nnfm_loss(3 * feats, longer))
    assert loss <= nnfm_loss(feats, style[:10]) + EXACT


def test_gradient():
    feats, style = randn(4, 8, seed=0).double().requires_grad_(), randn(5, 8, seed=1).double()
    assert torch.autograd.gradcheck(lambda x: nnfm_loss(x, style), feats)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize(("count", "styles", "width"), [(500, 333, 96), (37, 65, 256), (64, 48, 7)])
def test_the_loss_is_that_of_the_exhaustive_search(
    count: int, styles: int, width: int, dtype: torch.dtype
):
    feats, style = features(count, width, seed=0), features(styles, width, seed=1)
    index = build_index(style, dtype)
    found, _ = index.nearest(feats.to(dtype), index.no_favour())
    assert found.min() >= 0 and found.max() < styles
    best = cosine_distance(feats, style[most_similar(feats, normalize(style))])
    loss = cosine_distance(feats, style[found])
    # matches lost in compression, and in bfloat16 those that differ by its rounding
    assert best * 0.9999 <= loss < 1.005 * best
    assert cosine_distance(feats, style.roll(1, 0)[found]) > 1.1 * best, "a check that can fail"


@pytest.mark.parametrize("styles", [1, 3, 16, 17, 63, 200])
def test_features_find_themselves(styles: int):
    style = features(styles, 128, seed=2)
    order = torch.randperm(styles, generator=torch.Generator().manual_seed(0))
    index = build_index(style, torch.float32)
    found, potentials = index.nearest(5 * style[order], index.no_favour())
    assert torch.equal(found, order), "lengths do not matter"
    assert index.nearest(style[:0], potentials)[0].shape == (0,)


def test_chunks_do_not_matter(monkeypatch: pytest.MonkeyPatch):
    feats, style = features(50, seed=3), normalize(features(70, seed=4))
    index = build_index(style, torch.float32)
    begin = index.no_favour()
    whole = index.nearest(feats, begin)[0], most_similar(feats, style)
    monkeypatch.setitem(matching.SIMILARITIES_AT_ONCE, "cpu", 7 * 80)
    assert torch.equal(index.nearest(feats, begin)[0], whole[0])
    assert torch.equal(most_similar(feats, style), whole[1])


def test_balanced_searches_use_a_style_as_often_as_it_has_each_kind():
    flat = torch.tensor([1.0, 0.0, 0.3]) + 0.01 * randn(20, 3, seed=0)
    lines = torch.tensor([0.0, 1.0, 0.3]) + 0.01 * randn(180, 3, seed=1)
    feats = torch.tensor([0.55, 0.45, 0.3]) + 0.05 * randn(400, 3, seed=2)
    style = torch.cat([flat, lines])

    def shares(*, balanced: bool) -> list[float]:
        index, found = build_index(style, torch.float32, balanced=balanced), list[float]()
        potentials = index.no_favour()
        for _ in range(60):
            rows, potentials = index.nearest(feats, potentials)
            found.append(float((rows < len(flat)).float().mean()))
        return found

    nearest = shares(balanced=False)
    assert min(nearest) == max(nearest) > 0.8, "most are nearer to what is flat"
    last = sum(shares(balanced=True)[-20:]) / 20
    assert last == pytest.approx(0.1, abs=0.1)


def test_the_same_query_has_the_same_matches():
    index = build_index(features(200, seed=5), torch.float32, balanced=True)
    feats, begin = features(300, seed=6), index.no_favour()
    first, after = index.nearest(feats, begin)
    for _ in range(2):
        again, _ = index.nearest(feats, begin)
        assert torch.equal(again, first)
    assert not torch.equal(after.favour, begin.favour)

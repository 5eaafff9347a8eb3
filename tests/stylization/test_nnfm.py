import pytest
import torch
from torch.nn.functional import normalize

from stylesplat.stylization import matching
from stylesplat.stylization.matching import nearest_rows, nnfm_loss

EXACT = 1e-6  # a few roundings of float32


def rows(count: int, seed: int, width: int = 8) -> torch.Tensor:
    return torch.randn(count, width, generator=torch.Generator().manual_seed(seed))


def test_features_match_themselves():
    feats = rows(50, 0)
    assert nnfm_loss(feats, feats) == pytest.approx(0, abs=EXACT)


def test_is_the_distance_to_the_most_similar_row():
    feats, style = rows(20, 0), rows(30, 1)
    cosines = torch.cosine_similarity(feats[:, None], style[None], dim=-1)
    torch.testing.assert_close(nnfm_loss(feats, style), (1 - cosines.amax(dim=1)).mean())
    assert torch.equal(nearest_rows(feats, normalize(style)), cosines.argmax(dim=1))


def test_order_of_the_style_does_not_matter():
    feats, style = rows(20, 0), rows(30, 1)
    torch.testing.assert_close(nnfm_loss(feats, style), nnfm_loss(feats, style.flip(0)))


def test_lengths_do_not_matter():
    feats, style = rows(20, 0), rows(30, 1)
    longer = style * torch.linspace(0.1, 9, 30)[:, None]
    torch.testing.assert_close(nnfm_loss(feats, style), nnfm_loss(3 * feats, longer))


def test_more_style_cannot_be_farther():
    feats, style = rows(20, 0), rows(30, 1)
    assert nnfm_loss(feats, style) <= nnfm_loss(feats, style[:10]) + EXACT


def test_opposite_features_are_two_apart():
    feats = rows(1, 0)
    assert nnfm_loss(feats, -feats) == pytest.approx(2, abs=EXACT)


def test_chunks_do_not_matter(monkeypatch: pytest.MonkeyPatch):
    feats, style = rows(20, 0), normalize(rows(30, 1))
    whole = nearest_rows(feats, style)
    monkeypatch.setattr(matching, "SIMILARITIES_AT_ONCE", 70)
    assert torch.equal(nearest_rows(feats, style), whole)


def test_gradient():
    feats, style = rows(4, 0).double().requires_grad_(), rows(5, 1).double()
    assert torch.autograd.gradcheck(lambda x: nnfm_loss(x, style), feats)

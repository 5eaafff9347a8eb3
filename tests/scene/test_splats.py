import torch

from scenes import random_splats


def test_other_values_in_some_rows():
    splats, rows = random_splats(6), torch.tensor([4, 1])
    part = torch.zeros(2, 3, requires_grad=True)
    changed = splats.with_rows(rows, {"scales": part, "opacities": torch.ones(2)})
    assert not changed.scales[rows].any() and changed.opacities[rows].tolist() == [1, 1]
    others = torch.tensor([0, 2, 3, 5])
    for name, tensor in changed.tensors().items():
        assert torch.equal(tensor[others], splats.tensors()[name][others]), name
    assert changed.means is splats.means and changed.classifier is splats.classifier
    (gradient,) = torch.autograd.grad(changed.scales.sum(), part)
    assert (gradient == 1).all()

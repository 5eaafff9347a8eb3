import torch

from stylesplat.training.adam import BETA1, BETA2, EPS, Moments, _step_cpu, _step_torch, adam_step


def gradients(count: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(6, 2, 3, generator=generator) for _ in range(count)]


def test_matches_torch():
    start = torch.ones(6, 2, 3)
    ours, theirs = start.clone().requires_grad_(), start.clone().requires_grad_()
    optimizer = torch.optim.Adam([theirs], lr=0.1, betas=(BETA1, BETA2), eps=EPS)
    params = {"x": ours}
    moments = Moments.zeros(params)
    for step, gradient in enumerate(gradients(5), start=1):
        ours.grad, theirs.grad = gradient.clone(), gradient.clone()
        adam_step(params, moments, {"x": 0.1}, step)
        optimizer.step()
    assert torch.allclose(ours, theirs, atol=1e-5)


def test_rows_that_are_not_seen_stay():
    param = torch.ones(6, 2, 3, requires_grad=True)
    moments = Moments.zeros({"x": param})
    param.grad = gradients(1)[0]
    seen = torch.tensor([True, False, True, False, False, True])
    adam_step({"x": param}, moments, {"x": 0.1}, 1, seen)
    assert torch.equal(param[~seen], torch.ones(3, 2, 3))
    assert not moments.first["x"][~seen].any()
    assert (param[seen] != 1).all()


def test_both_implementations_agree():
    seen = torch.tensor([True, True, False, True, False, True])
    results = []
    for step in (_step_cpu, _step_torch):
        tensors = tuple(t.clone() for t in (*gradients(3), gradients(4)[3] ** 2))
        step(tensors, 0.05, 0.3, seen)
        results.append(tensors)
    for one, other in zip(*results, strict=True):
        assert torch.allclose(one, other, atol=1e-6)


def test_taken_rows_keep_their_state_and_fresh_ones_are_zero():
    moments = Moments({"x": torch.arange(3.0), "y": torch.ones(1)}, {"x": torch.ones(3)})
    taken = moments.take(torch.tensor([2, -1, 0]), ("x",))
    assert taken.first["x"].tolist() == [2, 0, 0]
    assert taken.second["x"].tolist() == [1, 0, 1]
    assert taken.first["y"] is moments.first["y"]

import torch

from stylesplat.training.color_maps import BLOWN_OUT, aim, fitted, mapped


def rand(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def changed(scale: float = 0.1) -> torch.Tensor:
    return scale * (2 * rand(3, 4, seed=3) - 1)


def test_no_change_is_no_change():
    image = rand(5, 7, 3)
    assert torch.equal(mapped(image, rand(5, 7, 1), torch.zeros(3, 4)), image)


def test_a_change_is_an_affine_map_of_what_covers_a_pixel():
    image, alpha, change = rand(5, 7, 3), rand(5, 7, 1, seed=1), changed()
    expected = image[2, 3] + change[:, :3] @ image[2, 3] + change[:, 3] * alpha[2, 3]
    assert torch.allclose(mapped(image, alpha, change)[2, 3], expected)


def test_where_nothing_is_black_stays():
    assert not mapped(torch.zeros(2, 2, 3), torch.zeros(2, 2, 1), changed()).any()


def test_gradients_of_the_map():
    inputs = [
        t.double().requires_grad_() for t in (rand(3, 4, 3), rand(3, 4, 1, seed=1), changed())
    ]
    assert torch.autograd.gradcheck(mapped, inputs)


def test_what_was_changed_is_found():
    image, alpha, change = rand(30, 40, 3), rand(30, 40, 1, seed=1), changed()
    found = fitted(image, alpha, mapped(image, alpha, change).clamp(max=BLOWN_OUT - 0.01))
    assert (found - change).abs().max() < 0.03


def test_blown_out_pixels_do_not_count():
    image, alpha = 0.2 + 0.7 * rand(30, 40, 3), torch.ones(30, 40, 1)
    gain = torch.cat([0.5 * torch.eye(3), torch.zeros(3, 1)], dim=1)
    photo = mapped(image, alpha, gain).clamp(max=1)
    assert (photo == 1).float().mean() > 0.1
    # The prior takes a little off, less than what is blown out would
    assert (fitted(image, alpha, photo) - gain).abs().max() < 0.03


def test_with_nothing_to_see_nothing_is_changed():
    black = torch.zeros(4, 5, 3)
    assert not fitted(black, black[..., :1], black).any()


def test_what_is_blown_out_may_be_brighter():
    target = torch.tensor([1.0, 1.0, 0.5]).expand(1, 1, 3)
    image = torch.tensor([1.3, 0.8, 0.9]).expand(1, 1, 3)
    assert aim(image, target).flatten().tolist() == [torch.tensor(1.3).item(), 1.0, 0.5]

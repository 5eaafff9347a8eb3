import torch

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.poses import are_rigid
from stylesplat.training.pose_shifts import moved


def some_shifts(count: int) -> torch.Tensor:
    return 0.1 * torch.randn(count, 6, generator=torch.Generator().manual_seed(0))


def test_no_shift_moves_nothing(cameras: Cameras):
    same = moved(cameras, torch.zeros(len(cameras), 6), 2.0)
    assert torch.allclose(same.viewmats, cameras.viewmats, atol=1e-6)
    assert same.names == cameras.names


def test_shifts_are_of_the_world_in_units(cameras: Cameras):
    shifts = some_shifts(len(cameras))
    after = moved(cameras, shifts, 2.0)
    assert torch.allclose(after.positions, cameras.positions + 2 * shifts[:, 3:], atol=1e-5)
    assert are_rigid(after.viewmats, 1e-5).all()


def test_turns_are_about_axes_of_the_world(cameras: Cameras):
    shifts = torch.zeros(len(cameras), 6)
    shifts[:, 2] = torch.pi / 2  # x to y
    after = moved(cameras, shifts, 1.0)
    assert torch.allclose(after.positions, cameras.positions, atol=1e-5)
    axes = cameras.viewmats[:, :3, :3]  # in the world, one a row
    expected = torch.stack([-axes[..., 1], axes[..., 0], axes[..., 2]], dim=-1)
    assert torch.allclose(after.viewmats[:, :3, :3], expected, atol=1e-5)


def test_gradients(cameras: Cameras):
    shifts = some_shifts(2).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda s: moved(cameras[:2], s, 2.0).viewmats, shifts)

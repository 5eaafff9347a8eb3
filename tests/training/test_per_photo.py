import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.evaluation.photos import NO_FITS, Fits, evaluate_views
from stylesplat.scene.cameras import Cameras, are_rigid
from stylesplat.scene.capture import Capture
from stylesplat.training.initialize import scene_extent
from stylesplat.training.loop import fit
from stylesplat.training.per_photo import (
    BLOWN_OUT,
    apply_color_map,
    blown_out_target,
    fit_color_map,
    photo_gains,
    shift_cameras,
    with_refined_cameras,
)
from stylesplat.training.state import PER_PHOTO, State
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import TrainingView, split_views, training_views


@pytest.fixture
def plain(capture: Capture) -> Capture:
    return replace(capture, label_maps=None)


@pytest.fixture
def exposed(plain: Capture) -> Capture:
    """Photos of gains between 0.4 and 1.1."""
    random = torch.Generator().manual_seed(1)
    gains = 0.4 + 0.7 * torch.rand(len(plain), 1, generator=random)
    return with_gains(plain, gains * (1 + 0.05 * torch.randn(len(plain), 3, generator=random)))


@pytest.fixture
def tinted(plain: Capture) -> Capture:
    """Photos as bright as each other, in turn redder and bluer."""
    warm = torch.tensor([0.3, 0.0, -0.3])
    gains = torch.stack([(-1) ** row * warm for row in range(len(plain))]).exp()
    return with_gains(plain, 0.7 * gains)


def with_gains(capture: Capture, gains: Float[Tensor, "C 3"]) -> Capture:
    photos = [
        (photo * gain).clamp(0, 255).round().to(torch.uint8)
        for photo, gain in zip(capture.photos, gains, strict=True)
    ]
    return replace(capture, photos=photos)


@pytest.fixture
def shaken(plain: Capture) -> Capture:
    """Cameras that are a degree and a hundredth of their distance away from where they were."""
    noise = torch.randn(len(plain), 6, generator=torch.Generator().manual_seed(2))
    noise = noise / 3**0.5 * torch.tensor([0.02] * 3 + [0.01] * 3)
    return replace(plain, cameras=shift_cameras(plain.cameras, noise, scene_extent(plain.cameras)))


def closeness(state: State, capture: Capture, fits: Fits = NO_FITS) -> float:
    rows = range(len(capture))  # nothing of what was trained of them is in the splat
    return evaluate_views(state.splats.detach(), capture, rows, fits=fits)["psnr"]


def test_photos_of_other_exposures_train_better_with_a_correction(
    exposed: Capture, config: TrainConfig
):
    config, colors = replace(config, steps=240, sh_degree=0), Fits(colors=True)
    off, on = (fit(exposed, replace(config, color_correction=each)) for each in ("off", "on"))
    assert closeness(on, exposed, colors) > closeness(off, exposed, colors) + 0.5


def test_the_mean_photo_has_the_colours_of_the_splat(exposed: Capture, config: TrainConfig):
    state = fit(exposed, replace(config, color_correction="on"))
    changes = state.params["color_maps"].detach()
    assert changes.abs().amax(dim=(1, 2)).min() > 0.01
    assert changes.mean(dim=0).abs().max() < 1e-6


def test_auto_corrects_where_photos_differ(
    plain: Capture, exposed: Capture, config: TrainConfig, said: list[str]
):
    config = replace(config, steps=2, color_correction="auto")
    assert "color_maps" in fit(exposed, config).params
    assert any("differ in exposure" in line for line in said)
    said.clear()
    assert "color_maps" not in fit(plain, config).params
    assert not said
    assert "color_maps" not in fit(replace(exposed, points=None, point_colors=None), config).params


def test_auto_corrects_white_balance(tinted: Capture, config: TrainConfig, said: list[str]):
    assert "color_maps" in fit(tinted, replace(config, steps=2)).params
    assert any("white balance" in line for line in said)


def test_nothing_of_a_photo_is_in_the_splat(exposed: Capture, config: TrainConfig):
    state = fit(exposed, replace(config, steps=3, color_correction="on", refine_poses=True))
    assert set(PER_PHOTO) < set(state.params)
    assert not set(PER_PHOTO) & set(state.names)
    assert not set(PER_PHOTO) & set(state.splats.tensors())


def test_continued_is_uninterrupted(exposed: Capture, config: TrainConfig, tmp_path: Path):
    config = replace(config, steps=30, color_correction="on", refine_poses=True)
    whole, path = fit(exposed, config), tmp_path / "checkpoint.pt"

    def stop(state: State, loss: float, psnr: float) -> None:
        if state.step >= 13:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        fit(exposed, config, checkpoint=path, on_progress=stop)
    continued = fit(exposed, config, checkpoint=path)
    assert continued.step == 30
    for name, tensor in whole.params.items():
        assert torch.equal(tensor, continued.params[name]), name


def test_noisy_poses_get_better(plain: Capture, shaken: Capture, config: TrainConfig):
    config = replace(config, steps=400, test_every=0, color_correction="off")
    as_given, state = (fit(shaken, replace(config, refine_poses=on)) for on in (False, True))
    found = with_refined_cameras(shaken, state, range(len(shaken)))
    # A turn and a shift look nearly alike in 72 pixels, so much of each stays
    assert spread(found.cameras, plain.cameras) < 0.9 * spread(shaken.cameras, plain.cameras)
    assert are_rigid(found.cameras.viewmats, 1e-5).all()
    assert closeness(state, found) > closeness(as_given, shaken) + 1


def test_the_world_stays_where_it_is(shaken: Capture, config: TrainConfig):
    state = fit(shaken, replace(config, refine_poses=True))
    rows, held_out = split_views(shaken, config.test_every)
    shifts = state.params["pose_shifts"].detach()
    assert shifts.abs().amax(dim=1).min() > 1e-4
    assert shifts.mean(dim=0).abs().max() < 1e-7
    cameras = with_refined_cameras(shaken, state, rows).cameras
    assert not torch.equal(cameras.viewmats[rows], shaken.cameras.viewmats[rows])
    assert torch.equal(cameras.viewmats[held_out], shaken.cameras.viewmats[held_out])


def spread(cameras: Cameras, truth: Cameras) -> float:
    """Root mean square of what cameras are turned against the true ones, beyond all together."""
    turns = truth.viewmats[:, :3, :3].mT @ cameras.viewmats[:, :3, :3]
    axes = torch.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], dim=1)  # small angles
    return float((axes - axes.mean(dim=0)).square().sum(dim=1).mean().sqrt())


def rand(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def changed(scale: float = 0.1) -> torch.Tensor:
    return scale * (2 * rand(3, 4, seed=3) - 1)


def test_a_change_is_an_affine_map_of_what_covers_a_pixel():
    image, alpha, change = rand(5, 7, 3), rand(5, 7, 1, seed=1), changed()
    expected = image[2, 3] + change[:, :3] @ image[2, 3] + change[:, 3] * alpha[2, 3]
    assert torch.allclose(apply_color_map(image, alpha, change)[2, 3], expected)


def test_gradients_of_the_map():
    inputs = [
        t.double().requires_grad_() for t in (rand(3, 4, 3), rand(3, 4, 1, seed=1), changed())
    ]
    assert torch.autograd.gradcheck(apply_color_map, inputs)


def test_what_was_changed_is_found():
    image, alpha, change = rand(30, 40, 3), rand(30, 40, 1, seed=1), changed()
    found = fit_color_map(
        image, alpha, apply_color_map(image, alpha, change).clamp(max=BLOWN_OUT - 0.01)
    )
    assert (found - change).abs().max() < 0.03


def test_blown_out_pixels_do_not_count():
    image, alpha = 0.2 + 0.7 * rand(30, 40, 3), torch.ones(30, 40, 1)
    gain = torch.cat([0.5 * torch.eye(3), torch.zeros(3, 1)], dim=1)
    photo = apply_color_map(image, alpha, gain).clamp(max=1)
    assert (photo == 1).float().mean() > 0.1
    # The prior takes a little off, less than what is blown out would
    assert (fit_color_map(image, alpha, photo) - gain).abs().max() < 0.03


def test_what_is_blown_out_may_be_brighter():
    target = torch.tensor([1.0, 1.0, 0.5]).expand(1, 1, 3)
    image = torch.tensor([1.3, 0.8, 0.9]).expand(1, 1, 3)
    assert blown_out_target(image, target).flatten().tolist() == [
        torch.tensor(1.3).item(),
        1.0,
        0.5,
    ]


def views_of(capture: Capture):
    load = training_views(
        capture, range(len(capture)), ids=(), device=torch.device("cpu"), max_memory=1.0
    )

    def view(row: int) -> TrainingView:
        return load(row, 1)

    return view


def with_log_gains(capture: Capture, gains: torch.Tensor) -> Capture:
    photos = [
        (photo * gain).clamp(0, 255).round().to(torch.uint8)
        for photo, gain in zip(capture.photos, gains, strict=True)
    ]
    return replace(capture, photos=photos)


def test_gains_are_told_from_points(capture: Capture):
    assert capture.points is not None
    rows = range(len(capture))
    gains = 0.6 + 0.5 * torch.rand(len(capture), 3, generator=torch.Generator().manual_seed(1))
    before = photo_gains(capture.points, views_of(capture), rows)
    after = photo_gains(capture.points, views_of(with_log_gains(capture, gains)), rows)
    truth = gains.log() - gains.log().mean(dim=0)
    # Half of the points are hidden: what is left is of those, and differs as gains change
    assert (after - before - truth).abs().mean() < 0.4 * truth.abs().mean()
    assert torch.allclose(after.mean(dim=0), torch.zeros(3), atol=1e-5)


def test_photos_without_enough_points_count_as_typical(capture: Capture):
    assert capture.points is not None
    gains = photo_gains(capture.points[:3], views_of(capture), [0, 1, 2])
    assert not gains.any()


def some_shifts(count: int) -> torch.Tensor:
    return 0.1 * torch.randn(count, 6, generator=torch.Generator().manual_seed(0))


def test_no_shift_moves_nothing(cameras: Cameras):
    same = shift_cameras(cameras, torch.zeros(len(cameras), 6), 2.0)
    assert torch.allclose(same.viewmats, cameras.viewmats, atol=1e-6)
    assert same.names == cameras.names


def test_shifts_are_of_the_world_in_units(cameras: Cameras):
    shifts = some_shifts(len(cameras))
    after = shift_cameras(cameras, shifts, 2.0)
    assert torch.allclose(after.positions, cameras.positions + 2 * shifts[:, 3:], atol=1e-5)
    assert are_rigid(after.viewmats, 1e-5).all()


def test_turns_are_about_axes_of_the_world(cameras: Cameras):
    shifts = torch.zeros(len(cameras), 6)
    shifts[:, 2] = torch.pi / 2  # x to y
    after = shift_cameras(cameras, shifts, 1.0)
    assert torch.allclose(after.positions, cameras.positions, atol=1e-5)
    axes = cameras.viewmats[:, :3, :3]  # in the world, one a row
    expected = torch.stack([-axes[..., 1], axes[..., 0], axes[..., 2]], dim=-1)
    assert torch.allclose(after.viewmats[:, :3, :3], expected, atol=1e-5)


def test_gradients(cameras: Cameras):
    shifts = some_shifts(2).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda s: shift_cameras(cameras[:2], s, 2.0).viewmats, shifts)

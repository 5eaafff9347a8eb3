from dataclasses import replace
from pathlib import Path

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from processes import interrupt
from scenes import rand, randn
from stylesplat.evaluation.photos import NO_FITS, Fits, evaluate_views
from stylesplat.scene.cameras import Cameras, are_rigid
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.per_photo import (
    BLOWN_OUT,
    apply_color_map,
    fit_color_map,
    shift_cameras,
    with_refined_cameras,
)
from stylesplat.training.state import PER_PHOTO, State
from stylesplat.training.views import split_views


@pytest.fixture
def plain(capture: Capture) -> Capture:
    return replace(capture, label_maps=None)


@pytest.fixture
def exposed(plain: Capture) -> Capture:
    """Photos of gains between 0.4 and 1.1, and a little tinted."""
    return with_gains(plain, (0.4 + 0.7 * rand(len(plain), 1)) * (0.95 + 0.1 * rand(len(plain), 3)))


def with_gains(capture: Capture, gains: Float[Tensor, "C 3"]) -> Capture:
    photos = [
        (photo * gain).clamp(0, 255).round().to(torch.uint8)
        for photo, gain in zip(capture.photos, gains, strict=True)
    ]
    return replace(capture, photos=photos)


@pytest.fixture
def shaken(plain: Capture) -> Capture:
    """Cameras that are a degree and a hundredth of their distance away from where they were."""
    noise = randn(len(plain), 6, seed=2)
    noise = noise / 3**0.5 * torch.tensor([0.02] * 3 + [0.01] * 3)
    return replace(plain, cameras=shift_cameras(plain.cameras, noise, scene_extent(plain.cameras)))


def closeness(state: State, capture: Capture, fits: Fits = NO_FITS) -> float:
    rows = range(len(capture))  # nothing of what was trained of them is in the splat
    return evaluate_views(state.splats.detach(), capture, rows, fits=fits)["psnr"]


def test_photos_of_other_exposures_train_better_with_a_correction(
    exposed: Capture, config: TrainConfig
):
    config, colors = replace(config, steps=120, sh_degree=0), Fits(colors=True)
    off, on = (fit(exposed, replace(config, color_correction=each)) for each in ("off", "on"))
    assert closeness(on, exposed, colors) > closeness(off, exposed, colors) + 0.5
    changes = on.params["color_maps"].detach()
    assert changes.abs().amax(dim=(1, 2)).min() > 0.01
    assert changes.mean(dim=0).abs().max() < 1e-6, "the splat has the mean photo's colours"


def test_auto_corrects_where_photos_differ(
    plain: Capture, exposed: Capture, config: TrainConfig, said: list[str]
):
    config = replace(config, steps=2, color_correction="auto")
    without = replace(exposed, points=None, point_colors=None)
    for capture in (plain, without):
        assert "color_maps" not in fit(capture, config).params
        assert not any("exposure" in line for line in said)
    warm = torch.tensor([0.3, 0.0, -0.3])  # in turn redder and bluer
    tints = torch.stack([(-1) ** row * warm for row in range(len(plain))]).exp()
    for capture in (exposed, with_gains(plain, 0.7 * tints)):
        assert "color_maps" in fit(capture, config).params
        assert "differ in exposure or white balance" in said.pop()


def test_continued_is_uninterrupted_and_nothing_of_a_photo_is_in_the_splat(
    exposed: Capture, config: TrainConfig, tmp_path: Path
):
    config = replace(config, steps=30, color_correction="on", refine_poses=True)
    whole, path = fit(exposed, config), tmp_path / "checkpoint.pt"
    interrupt(exposed, config, path, 13)
    continued = fit(exposed, config, checkpoint=path)
    assert continued.step == 30
    for name, tensor in whole.params.items():
        assert torch.equal(tensor, continued.params[name]), name
    assert set(PER_PHOTO) < set(whole.params)
    assert not set(PER_PHOTO) & {*whole.names, *whole.splats.tensors()}


def spread(cameras: Cameras, truth: Cameras) -> float:
    """Root mean square of what cameras are turned against the true ones, beyond all together."""
    turns = truth.viewmats[:, :3, :3].mT @ cameras.viewmats[:, :3, :3]
    axes = torch.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], dim=1)  # small angles
    return float((axes - axes.mean(dim=0)).square().sum(dim=1).mean().sqrt())


def test_noisy_poses_get_better(plain: Capture, shaken: Capture, config: TrainConfig):
    # Seeds 0 to 3 gain .9, 1.2, 1.8 and 2.0 dB
    config = replace(config, seed=2, steps=250, test_every=0, color_correction="off")
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
    cameras = with_refined_cameras(replace(shaken, full=shaken.cameras), state, rows).full
    assert cameras is not None
    assert not torch.equal(cameras.viewmats[rows], shaken.cameras.viewmats[rows])
    assert torch.equal(cameras.viewmats[held_out], shaken.cameras.viewmats[held_out])
    without = fit(shaken, replace(config, steps=2))
    assert with_refined_cameras(shaken, without, rows) is shaken


def color_map() -> Tensor:
    return 0.1 * (2 * rand(3, 4, seed=3) - 1)


def test_the_color_map_of_a_photo_is_found():
    image, alpha, change = rand(30, 40, 3), rand(30, 40, 1, seed=1), color_map()
    photo = apply_color_map(image, alpha, change).clamp(max=BLOWN_OUT - 0.01)
    assert (fit_color_map(image, alpha, photo) - change).abs().max() < 0.03
    # Blown-out pixels do not count
    image, alpha = 0.2 + 0.7 * image, torch.ones(30, 40, 1)
    gain = torch.cat([0.5 * torch.eye(3), torch.zeros(3, 1)], dim=1)
    photo = apply_color_map(image, alpha, gain).clamp(max=1)
    assert (photo == 1).float().mean() > 0.1
    # The prior takes a little off, less than what is blown out would
    assert (fit_color_map(image, alpha, photo) - gain).abs().max() < 0.03


def test_shifts_are_of_the_world_in_units(cameras: Cameras):
    shifts = 0.1 * randn(len(cameras), 6)
    after = shift_cameras(cameras, shifts, 2.0)
    assert torch.allclose(after.positions, cameras.positions + 2 * shifts[:, 3:], atol=1e-5)
    assert are_rigid(after.viewmats, 1e-5).all()
    still = shift_cameras(cameras, torch.zeros(len(cameras), 6), 2.0)
    assert torch.allclose(still.viewmats, cameras.viewmats, atol=1e-6)
    inputs = shifts[:2].double().requires_grad_()
    assert torch.autograd.gradcheck(lambda s: shift_cameras(cameras[:2], s, 2.0).viewmats, inputs)

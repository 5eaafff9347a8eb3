import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.photos import NO_FITS, Fits, evaluate_views
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.poses import are_rigid
from stylesplat.training.initialize import scene_extent
from stylesplat.training.loop import fit
from stylesplat.training.pose_shifts import moved, refined
from stylesplat.training.state import PER_PHOTO, State
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views


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
    return replace(plain, cameras=moved(plain.cameras, noise, scene_extent(plain.cameras)))


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


def test_without_them_nothing_changes(plain: Capture, config: TrainConfig):
    one, other = (fit(plain, replace(config, color_correction=each)) for each in ("off", "auto"))
    assert one.params.keys() == other.params.keys()
    assert all(torch.equal(t, other.params[name]) for name, t in one.params.items())


def test_one_photo_learns_at_a_time(plain: Capture, config: TrainConfig):
    state = fit(plain, replace(config, steps=1, color_correction="on"))
    assert int(state.moments.first["color_maps"].flatten(1).any(dim=1).sum()) == 1


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


@pytest.mark.parametrize("setting", [{"color_correction": "on"}, {"refine_poses": True}])
def test_checkpoints_of_the_other_kind_are_refused(
    plain: Capture, config: TrainConfig, tmp_path: Path, setting: dict
):
    path = tmp_path / "checkpoint.pt"
    config = replace(config, steps=2, color_correction="off")
    fit(plain, config, checkpoint=path)
    with pytest.raises(StyleSplatError, match=f"a run with another {next(iter(setting))}\\."):
        fit(plain, replace(config, **setting), checkpoint=path)


def test_noisy_poses_get_better(plain: Capture, shaken: Capture, config: TrainConfig):
    config = replace(config, steps=400, test_every=0, color_correction="off")
    as_given, state = (fit(shaken, replace(config, refine_poses=on)) for on in (False, True))
    found = refined(shaken, state, range(len(shaken)))
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
    cameras = refined(shaken, state, rows).cameras
    assert not torch.equal(cameras.viewmats[rows], shaken.cameras.viewmats[rows])
    assert torch.equal(cameras.viewmats[held_out], shaken.cameras.viewmats[held_out])


def spread(cameras: Cameras, truth: Cameras) -> float:
    """Root mean square of what cameras are turned against the true ones, beyond all together."""
    turns = truth.viewmats[:, :3, :3].mT @ cameras.viewmats[:, :3, :3]
    axes = torch.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], dim=1)  # small angles
    return float((axes - axes.mean(dim=0)).square().sum(dim=1).mean().sqrt())

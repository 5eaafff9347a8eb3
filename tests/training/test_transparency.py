"""Cut-out photos train like photos before black, and nothing grows where they are transparent."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from ball_photos import write_cut_outs
from balls import CAMERAS, enlarged
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.training.gradients import _behind
from stylesplat.training.loop import fit
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import View, split_views
from stylesplat.verbs.load import load

CONFIG = TrainConfig(steps=250, max_gaussians=400, photos_at_once=1)


@pytest.fixture(scope="module")
def cut_outs(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("cut_outs") / "balls"
    return load(write_cut_outs(folder, enlarged(CAMERAS, 2)))


@pytest.fixture(scope="module")
def splats(cut_outs: Capture) -> Splats:
    return fit(cut_outs, CONFIG).splats.detach()


def quality(splats: Splats, capture: Capture) -> float:
    _, held_out = split_views(capture, CONFIG.test_every)
    return evaluate_views(splats, replace(capture, label_maps=None), held_out)["psnr"]


def test_cut_outs_train_like_photos_before_black(cut_outs: Capture, splats: Splats):
    black = replace(cut_outs, alphas=None)
    over_black = fit(black, CONFIG).splats.detach()
    # Seeds differ by some tenths of a dB, and random backgrounds are worth 1.6 dB more at this
    # length; white walls before the cameras cost ten.
    assert quality(splats, cut_outs) == pytest.approx(quality(over_black, cut_outs), abs=2.2)
    assert quality(splats, cut_outs) > 22


def test_nothing_is_where_photos_are_transparent(cut_outs: Capture, splats: Splats):
    for row in range(len(cut_outs)):
        alpha = cut_outs.alpha(row)
        assert alpha is not None
        _, coverage, _ = rasterize(splats, cut_outs.cameras[row])
        assert coverage[0, ..., 0][alpha == 0].mean() < 0.05
        assert coverage[0, ..., 0][alpha > 250].mean() > 0.9


def test_there_is_an_object_to_select(cut_outs: Capture, splats: Splats):
    picked = pick(splats, object_id=1)
    assert picked.float().mean() > 0.5
    _, coverage, _ = rasterize(splats[picked], cut_outs.cameras[0])
    alpha = cut_outs.alpha(0)
    assert alpha is not None
    agree = (coverage[0, ..., 0] > 0.5) == (alpha >= 128)
    assert agree.float().mean() > 0.95


def view(alpha: torch.Tensor | None) -> View:
    photo = torch.full((4, 5, 3), 0.25)
    return View(CAMERAS[0], photo, alpha, None)


def test_photos_without_alpha_are_before_black():
    background, target = _behind(view(None), torch.Generator())
    assert background is None and torch.equal(target, torch.full((4, 5, 3), 0.25))


def test_a_photo_is_laid_over_the_colour_as_much_as_it_is_transparent():
    alpha = torch.linspace(0, 1, 20).view(4, 5, 1)
    color, target = _behind(view(alpha), torch.Generator().manual_seed(0))
    assert color is not None
    expected = 0.25 + (1 - alpha) * color
    assert torch.equal(target, expected)
    assert torch.equal(target[-1, -1], torch.full((3,), 0.25)), "opaque pixels are themselves"


def test_colours_follow_from_the_generator():
    alpha = torch.zeros(4, 5, 1)
    colors = [_behind(view(alpha), torch.Generator().manual_seed(i // 2))[0] for i in range(4)]
    one, same, other, _ = colors
    assert one is not None and same is not None and other is not None
    assert torch.equal(one, same) and not torch.equal(one, other)
    assert ((one >= 0) & (one <= 1)).all()


def test_training_on_cut_outs_continues_and_repeats(cut_outs: Capture, tmp_path: Path):
    config = replace(CONFIG, steps=30)
    path = tmp_path / "checkpoint.pt"

    def killed(state: State, loss: float, psnr: float) -> None:
        if state.step == 20:
            raise RuntimeError("killed")

    with pytest.MonkeyPatch.context() as patch, pytest.raises(RuntimeError):
        patch.setattr("stylesplat.training.keeper.CHECKPOINT_SECONDS", 0.0)
        fit(cut_outs, config, checkpoint=path, on_progress=killed)
    assert path.exists()
    continued, straight = fit(cut_outs, config, checkpoint=path), fit(cut_outs, config)
    for name, tensor in straight.params.items():
        assert torch.equal(tensor, continued.params[name]), name

"""Cut-out photos train like photos before black, and nothing grows where they are transparent."""

from dataclasses import replace

import pytest

from balls import CAMERAS, enlarged
from capture_files import write_cut_outs
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views
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

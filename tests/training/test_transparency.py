"""Cut-out photos can be trained on, and nothing grows where they are transparent."""

from dataclasses import replace
from pathlib import Path

import pytest

from balls import CAMERAS, enlarged
from capture_files import write_cut_outs
from stylesplat.evaluation.photos import evaluate_views
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views
from stylesplat.verbs.load import load

CONFIG = TrainConfig(steps=250, max_gaussians=400, photos_at_once=1)


@pytest.fixture
def cut_outs(tmp_path: Path) -> Capture:
    folder = tmp_path / "balls"
    return load(write_cut_outs(folder, enlarged(CAMERAS, 2)))


def test_nothing_is_where_photos_are_transparent(cut_outs: Capture):
    splats = fit(cut_outs, CONFIG).splats.detach()
    _, held_out = split_views(cut_outs, CONFIG.test_every)
    assert evaluate_views(splats, replace(cut_outs, label_maps=None), held_out)["psnr"] > 22
    for row in range(len(cut_outs)):
        alpha = cut_outs.alpha(row)
        assert alpha is not None
        _, coverage, _ = rasterize(splats, cut_outs.cameras[row])
        assert coverage[0, ..., 0][alpha == 0].mean() < 0.05
        assert coverage[0, ..., 0][alpha > 250].mean() > 0.9

from dataclasses import replace

import torch

from stylesplat.scene.capture import Capture
from stylesplat.training.photo_gains import photo_gains
from stylesplat.training.training_views import View, training_views


def views_of(capture: Capture):
    load = training_views(
        capture, range(len(capture)), ids=(), device=torch.device("cpu"), max_memory=1.0
    )

    def view(row: int) -> View:
        return load(row, 1)

    return view


def exposed(capture: Capture, gains: torch.Tensor) -> Capture:
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
    after = photo_gains(capture.points, views_of(exposed(capture, gains)), rows)
    truth = gains.log() - gains.log().mean(dim=0)
    # Half of the points are hidden: what is left is of those, and differs as gains change
    assert (after - before - truth).abs().mean() < 0.4 * truth.abs().mean()
    assert torch.allclose(after.mean(dim=0), torch.zeros(3), atol=1e-5)


def test_photos_without_enough_points_count_as_typical(capture: Capture):
    assert capture.points is not None
    gains = photo_gains(capture.points[:3], views_of(capture), [0, 1, 2])
    assert not gains.any()

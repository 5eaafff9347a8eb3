import torch
from torch import Tensor

from balls import CAMERAS, SPLATS
from stylesplat.imaging.color import photo_gains
from stylesplat.rendering.render import render


def test_gains_are_found_from_points():
    photos = [render(SPLATS, camera)[0].detach().clamp(0, 1) for camera in CAMERAS]
    generator = torch.Generator().manual_seed(0)
    points = SPLATS.means[torch.randperm(len(SPLATS), generator=generator)]
    factors = 0.6 + 0.5 * torch.rand(len(photos), 3, generator=generator)

    def gains(factors: Tensor) -> Tensor:
        changed = [photo * factor for photo, factor in zip(photos, factors, strict=True)]
        return photo_gains(points, zip(changed, CAMERAS, strict=True))

    before, after = gains(torch.ones_like(factors)), gains(factors)
    truth = factors.log() - factors.log().mean(dim=0)
    assert (after - before - truth).abs().mean() < 0.4 * truth.abs().mean()
    assert torch.allclose(after.mean(dim=0), torch.zeros(3), atol=1e-5)
    few = photo_gains(points[:3], zip(photos, CAMERAS, strict=True))
    assert few.isnan().all(), "too few points for a gain"
    photos[2] = 0 * photos[2]
    dark = gains(torch.ones_like(factors))
    assert dark[2].isnan().all() and dark.isnan().sum() == 3

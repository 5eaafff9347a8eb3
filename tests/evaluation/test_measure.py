from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.evaluation.measure import changes, view_loss
from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.views import ObjectView


def test_evenly_spaced():
    assert evenly(range(10), 2) == [2, 7]
    assert evenly(range(3), 5) == [0, 1, 2]
    assert evenly([], 4) == []


def test_nothing_changed():
    none = torch.zeros(len(SPLATS), dtype=torch.bool)
    found = changes(SPLATS, SPLATS, CAMERAS[:2], none)
    assert (found["changed_gaussians"], found["outside_psnr"], found["edge_psnr"]) == (0, 120, 120)


def test_what_changed_outside_is_found():
    picked = torch.arange(len(SPLATS)) >= 360  # the last ball
    sh0 = SPLATS.sh0.clone()
    sh0[200:280, :, 2] += 1  # the first ball
    found = changes(SPLATS, replace(SPLATS, sh0=sh0), CAMERAS[:2], picked)
    assert found["changed_gaussians"] == 80
    assert found["outside_max_difference"] == pytest.approx(SH_C0, rel=0.1)  # all but opaque
    assert found["outside_psnr"] < 30


def test_a_view_full_of_the_object():
    everything = torch.ones(len(SPLATS), dtype=torch.bool)
    near = crop(CAMERAS[0], [22, 15], [24, 17])
    assert changes(SPLATS, SPLATS, near, everything)["outside_psnr"] == 120


def test_the_background_has_no_say(network: FeatureNetwork):
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(40, 50, 3, generator=generator).requires_grad_()
    mask = torch.zeros(20, 25, dtype=torch.bool)
    mask[6, 9] = True
    style = torch.rand(30, 12, generator=generator)
    view_loss(
        image,
        ObjectView(CAMERAS[0], (mask,), torch.ones(40, 50, dtype=torch.bool)),
        [style],
        network,
        [2],
    ).backward()
    assert image.grad is not None
    cells = network.cells(2)
    top, left = (i * cells.stride - cells.before for i in (6, 9))
    inside = (slice(top, top + cells.size), slice(left, left + cells.size))
    assert image.grad[inside].abs().sum() == image.grad.abs().sum() > 0


def test_more_gaussians_count_as_changed_and_a_rim_is_seen():
    picked = (torch.arange(len(SPLATS)) >= 200) & (torch.arange(len(SPLATS)) < 280)
    more = SPLATS[torch.cat([torch.arange(len(SPLATS)), torch.tensor([205, 206])])]
    assert changes(SPLATS, more, CAMERAS[:1], picked)["changed_gaussians"] == 2
    repainted = replace(SPLATS, sh0=SPLATS.sh0 + 1.0 * picked[:, None, None])
    found = changes(SPLATS, repainted, CAMERAS[:1], picked)
    assert found["changed_gaussians"] == 80
    assert found["outside_max_difference"] == 0
    assert 0 < found["rim_error"] < 0.2  # the object's soft contour, no more

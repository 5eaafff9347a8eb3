from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.rendering.sh import SH_C0
from stylesplat.stylization.measure import changes, evenly
from stylesplat.stylization.views import crop


def test_evenly_spaced():
    assert evenly(range(10), 2) == [2, 7]
    assert evenly(range(3), 5) == [0, 1, 2]
    assert evenly([], 4) == []


def test_nothing_changed():
    none = torch.zeros(len(SPLATS), dtype=torch.bool)
    found = changes(SPLATS, SPLATS, CAMERAS[:2], none, backend="reference")
    assert (found["changed_gaussians"], found["outside_psnr"], found["edge_psnr"]) == (0, 120, 120)


def test_what_changed_outside_is_found():
    picked = torch.arange(len(SPLATS)) >= 360  # the last ball
    sh0 = SPLATS.sh0.clone()
    sh0[200:280, :, 2] += 1  # the first ball
    found = changes(SPLATS, replace(SPLATS, sh0=sh0), CAMERAS[:2], picked, backend="reference")
    assert found["changed_gaussians"] == 80
    assert found["outside_max_difference"] == pytest.approx(SH_C0, rel=0.1)  # all but opaque
    assert found["outside_psnr"] < 30


def test_a_view_full_of_the_object():
    everything = torch.ones(len(SPLATS), dtype=torch.bool)
    near = crop(CAMERAS[0], [22, 15], [24, 17])
    assert changes(SPLATS, SPLATS, near, everything, backend="reference")["outside_psnr"] == 120

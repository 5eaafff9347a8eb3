"""What a step of painting asks of a GPU; on any machine, see `fake_cuda.py`."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from balls import CAMERAS, SPLATS, ball
from fake_cuda import HostTrips, Operations, cuda  # noqa: F401  (a fixture)
from stylesplat.imaging.similarity import blur_matrix
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import TiledContributions
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.painter import paint_steps
from stylesplat.stylization.painting import Painting, paint_setup
from stylesplat.stylization.views import find_boxes, object_views


@pytest.mark.usefixtures("quick_painting")
@pytest.mark.parametrize(
    ("settings", "most"),
    [({"steps": 12, "content": 0.5}, 210), ({"steps": 4, "published": True}, 160)],
    ids=["canvas", "published"],
)
def test_steps_never_wait_for_the_device_and_ask_for_few_operations(
    cuda: str,  # noqa: F811
    network: FeatureNetwork,
    stripes: Tensor,
    settings: dict[str, Any],
    most: int,
):
    """Python starts each operation by itself on a GPU; docs/scale.md says how many there are."""
    config = StyleConfig(block=2, scale=1.5, object_size=24, **settings)
    target = Painting("ball", ball(0).to(cuda), (stripes.to(cuda),), config)
    context = paint_setup(SPLATS.to(cuda), CAMERAS[:2], network.to(cuda))
    inner, last = set[int](), 0
    for stage in config.stages(24.0):  # its first step also prepares it, its last completes it
        inner |= {*range(last + 2, last + stage.steps)}
        last += stage.steps
    trips, counts = {}, {}
    with HostTrips() as mode, Operations() as operations:
        for state in paint_steps(context, target):
            trips[state.step], mode.found = mode.found, []
            counts[state.step], operations.count = operations.count, 0
            blur_matrix.cache_clear()  # as where there are more views than it holds
    assert len(inner) >= 2
    assert trips[1], "preparing asks the device"
    assert not any(trips[step] for step in inner), {step: trips[step] for step in inner}
    assert max(counts[step] for step in inner) <= most


def test_views_on_a_device_rasterize_what_reaches_them(cuda: str, network: FeatureNetwork):  # noqa: F811
    matte = replace(SPLATS, shN=torch.zeros_like(SPLATS.shN))
    splats, mask = matte.to(cuda), ball(0).to(cuda)
    target = Painting("ball", mask, (), StyleConfig(block=2))
    context = paint_setup(splats, CAMERAS, network.to(cuda))
    boxes = find_boxes(splats, CAMERAS[:2], mask)
    for view in object_views(context, target, boxes, 1.0, max_memory=1e9):
        assert isinstance(view.linear, TiledContributions)
        assert len(view.linear.gaussians) + view.linear.others < len(splats)
        whole = rasterize(splats, view.camera)[0][0]
        torch.testing.assert_close(view.render(splats.sh0[mask, 0]).cpu(), whole.cpu())

"""An object's surface, as its views show it."""

import torch
from torch import Tensor

from stylesplat.stylization.surface import BESIDE, PULLS, pull_inside


def test_a_flat_side_beyond_the_silhouettes_is_moved_inwards():
    size, side = 0.1, 60
    axis = size * torch.arange(float(side))
    x, y = torch.meshgrid(axis, axis, indexing="ij")
    points = torch.stack([x, y, torch.zeros_like(x)], dim=2).flatten(0, 1)
    normals = torch.tensor([0.0, 0.0, 1.0]).expand(len(points), 3)

    def outside(points: Tensor) -> Tensor:
        """In one half of the side silhouettes are two pixels lower, in the last rows more."""
        x = points[:, 0] / (size * side)
        lower = torch.where(x > 0.8, PULLS + 1.0, torch.where(x > 0.45, 1.5, -1.0))
        return points[:, 2] > -lower * size

    moved = points.clone()
    kept = pull_inside(moved, normals, size, outside)
    x = points[:, 0] / (size * side)
    lower = (x > 0.45) & (x <= 0.8)
    assert kept[x <= 0.45].all() and torch.equal(moved[x <= 0.45], points[x <= 0.45])
    far = lower & (x > 0.45 + (BESIDE + 1) / side)  # nearer ones have kept points beside them
    assert kept[far].all() and (moved[far, 2] + 2 * size).abs().max() < 1e-5
    assert not kept[x > 0.8].any(), "so far outside is no surface"

"""An object's surface, as its views show it."""

import torch
from torch import Tensor

from stylesplat.stylization.canvas import HOLE, PULLS, SURFACE_BESIDE, project_into_silhouettes

SIZE, SIDE = 0.1, 60  # of a pixel, and pixels of the side


def flat_side() -> tuple[Tensor, Tensor]:
    """Places, and the normal of each."""
    axis = SIZE * torch.arange(float(SIDE))
    x, y = torch.meshgrid(axis, axis, indexing="ij")
    points = torch.stack([x, y, torch.zeros_like(x)], dim=2).flatten(0, 1)
    return points, torch.tensor([0.0, 0.0, 1.0]).expand(len(points), 3)


def test_a_flat_side_beyond_the_silhouettes_is_moved_inwards():
    points, normals = flat_side()
    solid = torch.ones(len(points), dtype=torch.bool)

    def outside(points: Tensor) -> Tensor:
        """In one half of the side silhouettes are two pixels lower, in the last rows more."""
        x = points[:, 0] / (SIZE * SIDE)
        lower = torch.where(x > 0.8, PULLS + 1.0, torch.where(x > 0.45, 1.5, -1.0))
        return points[:, 2] > -lower * SIZE

    moved = points.clone()
    kept = project_into_silhouettes(moved, normals, solid, SIZE, outside)
    x = points[:, 0] / (SIZE * SIDE)
    lower = (x > 0.45) & (x <= 0.8)
    assert kept[x <= 0.45].all() and torch.equal(moved[x <= 0.45], points[x <= 0.45])
    far = lower & (
        x > 0.45 + (SURFACE_BESIDE + 1) / SIDE
    )  # nearer ones have kept points beside them
    assert kept[far].all() and (moved[far, 2] + 2 * SIZE).abs().max() < 1e-5
    assert not kept[x > 0.8].any(), "so far outside is no surface"


def test_what_is_less_solid_fills_holes_alone():
    points, normals = flat_side()
    middle = SIZE * torch.tensor([SIDE / 3, SIDE / 2, 0])
    far = (points - middle).norm(dim=1) / SIZE
    beside = points[:, 0] / SIZE > SIDE - HOLE  # as at a soft edge

    def kept(solid: Tensor) -> Tensor:
        return project_into_silhouettes(
            points.clone(), normals, solid, SIZE, lambda points: torch.zeros(len(points)).bool()
        )

    hole = far < 2 * HOLE
    found = kept(~hole & ~beside)
    assert found[~hole & ~beside].all()
    assert found[far < 2 * HOLE - SURFACE_BESIDE - 1].all()
    assert not found[beside].any()
    assert not kept(torch.zeros(len(points)).bool()).any(), "smoke has no surface"

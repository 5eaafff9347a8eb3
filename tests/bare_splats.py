"""Splats of other programs, as they come without photos: things of several shapes."""

import math
from dataclasses import replace

import torch

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import Content
from stylesplat.scene.projection import shown
from stylesplat.scene.splats import Splats

UP = torch.tensor([0.0, 0.0, 1.0])


def cloud(points: torch.Tensor, sigma: float = 0.01, opacity: float = 2.0) -> Splats:
    """Round grey Gaussians at some places."""
    count = len(points)
    return Splats(
        means=points.float(),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), math.log(sigma)),
        opacities=torch.full((count,), opacity),
        sh0=torch.zeros(count, 1, 3),
        shN=torch.zeros(count, 0, 3),
    )


def joined(*splats: Splats) -> Splats:
    """All of them as one."""
    tensors = [each.tensors() for each in splats]
    return replace(
        splats[0], **{name: torch.cat([t[name] for t in tensors]) for name in tensors[0]}
    )


def box(count: int, low: list[float], high: list[float], seed: int = 0) -> torch.Tensor:
    """Points within a box."""
    generator = torch.Generator().manual_seed(seed)
    corner, opposite = torch.tensor(low), torch.tensor(high)
    return corner + (opposite - corner) * torch.rand(count, 3, generator=generator)


def shell(count: int, radius: float, seed: int = 0) -> torch.Tensor:
    """Points on a sphere around the origin."""
    generator = torch.Generator().manual_seed(seed)
    normals = torch.randn(count, 3, generator=generator)
    return radius * torch.nn.functional.normalize(normals, dim=1)


def guitar() -> Splats:
    """A body of 0.3 with most of the Gaussians, and a thin neck: 1 x 0.3 x 0.1 in all."""
    body = box(3000, [-0.15, -0.05, 0.0], [0.15, 0.05, 0.4])
    neck = box(250, [-0.02, -0.02, 0.4], [0.02, 0.02, 0.92], seed=1)
    head = box(50, [-0.05, -0.02, 0.92], [0.05, 0.02, 1.0], seed=2)
    return cloud(torch.cat([body, neck, head]))


def figure() -> Splats:
    """Upright, 1.8 tall and 0.5 wide."""
    return cloud(box(4000, [-0.25, -0.15, 0.0], [0.25, 0.15, 1.8], seed=3))


def floaters() -> Splats:
    """Far and opaque: single ones everywhere, and a clump of them."""
    clump = box(200, [29.8, -0.1, 4.9], [30.0, 0.1, 5.1], seed=4)
    return cloud(torch.cat([box(300, [-60] * 3, [60] * 3, seed=5), clump]), 0.2, opacity=6.0)


def painting() -> Splats:
    """Flat: 1.6 x 1 on a wall."""
    return cloud(box(3000, [-0.8, -0.002, 0.0], [0.8, 0.002, 1.0], seed=6))


def room() -> Splats:
    """Things on a table of 1 x 1 in a room of 6 x 6 x 3, whose walls are blurred."""
    things = box(6000, [-0.5, -0.5, 0.0], [0.5, 0.5, 0.4], seed=7)
    walls = box(1500, [-3.0, -3.0, -1.0], [3.0, 3.0, 2.0], seed=8)
    side, axis = torch.arange(len(walls)) % 2, torch.arange(len(walls)) // 2 % 3
    ends = torch.tensor([[-3.0, -3.0, -1.0], [3.0, 3.0, 2.0]])
    walls[torch.arange(len(walls)), axis] = ends[side, axis]
    return joined(cloud(things), cloud(walls, 0.2, opacity=4.0))


def shares(
    cameras: Cameras, points: torch.Tensor, weights: torch.Tensor | None = None
) -> list[float]:
    """The share of some points' weight that lies inside each view."""
    weights = torch.ones(len(points)) if weights is None else weights
    points = points.double()
    return [
        float(weights[shown(points, cameras[row])].sum() / weights.sum())
        for row in range(len(cameras))
    ]


def reaches(content: Content) -> list[float]:
    """The corners of the box around content."""
    return [*content.extent.low.tolist(), *content.extent.high.tolist()]

"""Discs turn along what is painted on them, and stretch as far as it has a direction."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from scenes import joined, rand
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.stylization.guides import LONG, NARROW, Guides, align_to_strokes

COUNT = 24  # discs along each side of a plane
DISTANCE = 0.05
OTHERS = 10  # Gaussians before the discs
DISCS = torch.arange(OTHERS + COUNT**2) >= OTHERS
GENERATOR = torch.Generator().manual_seed(0)
TILT = torch.tensor([0.9, 0.2, -0.3, 0.1])  # of the plane in space


PLACES = DISTANCE * (
    torch.cartesian_prod(*[torch.arange(float(COUNT))] * 2)
    + 0.4 * torch.rand(COUNT**2, 2, generator=GENERATOR)
)
# Discs at the border have neighbours on one side only
INSIDE = ((PLACES / DISTANCE > 4) & (PLACES / DISTANCE < COUNT - 4)).all(dim=1)


def plane(levels: Tensor, quat: Tensor = TILT) -> Splats:
    """Some Gaussians and a tilted plane of discs with grey levels in 0..1."""
    quat = F.normalize(quat, dim=0)
    means = F.pad(PLACES, (0, 1)) @ rotation_matrices(quat[None])[0].T
    colors = sh0_from_rgb(levels[:, None].expand(-1, 3))[:, None]
    others = rand(OTHERS, 3, seed=1)
    count = len(DISCS)
    return Splats(
        means=torch.cat([others, means]),
        quats=quat.repeat(count, 1),
        scales=(DISTANCE * torch.tensor([1.0, 1.0, 0.15])).log().repeat(count, 1),
        opacities=torch.zeros(count),
        sh0=torch.cat([others[:, None], colors]),
        shN=torch.zeros(count, 0, 3),
    )


def stripes(angle: float, wavelength: float = 6.0) -> Tensor:
    """Levels of stripes at some angle to the plane's first axis, as wide as so many discs."""
    across = torch.tensor([-math.sin(angle), math.cos(angle)])
    return 0.5 + 0.3 * (2 * math.pi / (wavelength * DISTANCE) * PLACES @ across).sin()


def aligned(splats: Splats) -> Splats:
    return align_to_strokes(splats, DISCS, DISTANCE)


def way(angle: float, quat: Tensor = TILT) -> Tensor:
    """The direction of stripes, in space."""
    axes = rotation_matrices(F.normalize(quat, dim=0)[None])[0]
    return axes[:, 0] * math.cos(angle) + axes[:, 1] * math.sin(angle)


def stretch(before: Splats, after: Splats) -> Tensor:
    """Factors along the three axes of the discs inside."""
    return (after.scales - before.scales)[DISCS][INSIDE].exp()


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2, 2.5])
@pytest.mark.parametrize("quat", [TILT, torch.tensor([0.0, 1.0, 0.3, -2.0])], ids=["up", "down"])
def test_discs_turn_along_stripes(angle: float, quat: Tensor):
    splats = plane(stripes(angle), quat)
    turned = aligned(splats)
    axes = rotation_matrices(turned.quats[DISCS][INSIDE])
    along = (axes[:, :, 0] @ way(angle, quat)).abs()
    assert along.min() > math.cos(math.radians(10))
    assert along.mean() > math.cos(math.radians(4))
    normal = rotation_matrices(splats.quats[:1])[0, :, 2]
    assert torch.allclose(axes[:, :, 2], normal.expand(len(axes), 3), atol=1e-5), "in their plane"
    factors = stretch(splats, turned)
    assert (factors[:, 0] > 0.9 * LONG).all() and (factors[:, 1] < 1.2 * NARROW).all()
    torch.testing.assert_close(factors[:, 2], torch.ones(len(factors)))


def test_nothing_but_the_discs_turns_and_nothing_but_shapes_change():
    splats = plane(stripes(0.7))
    turned = aligned(splats)
    for name, before in splats.tensors().items():
        after = turned.tensors()[name]
        assert torch.equal(after[~DISCS], before[~DISCS]), name
        assert torch.equal(after, before) == (name not in ("quats", "scales")), name
    assert torch.allclose(turned.quats.norm(dim=1), splats.quats.norm(dim=1), atol=1e-5)


def test_only_coherent_paint_has_a_direction_however_faint():
    """Flat paint has none, noise hardly any; faint stripes count as strong ones do."""
    strong, faint = (plane(0.5 + share * (stripes(0.7) - 0.5)) for share in (1.0, 0.1))
    torch.testing.assert_close(aligned(faint).scales, aligned(strong).scales, atol=1e-3, rtol=0)
    flat = plane(torch.full((COUNT**2,), 0.4))
    assert torch.allclose(aligned(flat).scales, flat.scales, atol=1e-3)
    noise = plane(rand(COUNT**2, seed=2))
    longer = [stretch(each, aligned(each))[:, 0].mean() - 1 for each in (noise, strong)]
    assert longer[0] < 0.5 * longer[1]


def test_the_other_side_of_a_thin_sheet_has_no_say():
    """Stripes that cross those on the back, whose discs look the other way."""
    front, back = plane(stripes(0.0)), plane(stripes(math.pi / 2))
    w, x, y, z = back.quats.unbind(1)
    back = replace(back, quats=torch.stack([-x, w, z, -y], dim=1))  # half a turn about their x
    normals = [rotation_matrices(each.quats[:1])[0, :, 2] for each in (front, back)]
    assert torch.allclose(normals[0], -normals[1], atol=1e-6)
    means = back.means - 0.1 * DISTANCE * rotation_matrices(front.quats)[:, :, 2]
    both = joined(front, replace(back, means=means)[DISCS])
    discs = torch.cat([DISCS, DISCS[DISCS]])
    found = align_to_strokes(both, discs, DISTANCE).quats[: len(DISCS)]
    along = (rotation_matrices(found[DISCS][INSIDE])[:, :, 0] @ way(0.0)).abs()
    assert along.min() > math.cos(math.radians(15))


def test_discs_turn_along_a_line_where_it_counts():
    splats, line = plane(stripes(0.0)), way(1.2)
    middle = splats.means[DISCS].mean(dim=0)
    guides = Guides(middle[None], line[None], reach=5 * DISTANCE)
    turned = align_to_strokes(splats, DISCS, DISTANCE, guides)
    axes = rotation_matrices(turned.quats[DISCS])[:, :, 0]
    away = (splats.means[DISCS] - middle).norm(dim=1)
    near, far = away < 2 * DISTANCE, INSIDE & (away > 9 * DISTANCE)
    assert ((axes[near] @ line).abs() > math.cos(math.radians(15))).all()
    assert ((axes[far] @ way(0.0)).abs() > math.cos(math.radians(20))).all()


def test_few_discs():
    """Fewer than a fit usually has, down to one."""
    for count in (1, 2, 5):
        few = torch.arange(len(DISCS)) >= len(DISCS) - count
        turned = align_to_strokes(plane(stripes(0.3)), few, DISTANCE)
        assert turned.quats.isfinite().all() and turned.scales.isfinite().all()

from dataclasses import replace

import torch

from scenes import random_splats
from stylesplat.rendering.reference import spherical_harmonics
from stylesplat.scene.splats import SH_C0
from stylesplat.stylization.colors import NOISE, VARIATION, color_map, map_colors, vary_colors

NOISE_BIAS = 0.05  # the source's variances, 0.04 to 0.09, are raised by NOISE


def colors(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    axes = torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q
    spread = torch.tensor([0.3, 0.25, 0.2])[:, None] * axes
    return 0.5 + torch.randn(count, 3, generator=generator) @ spread


def test_mean_and_covariance_become_the_targets():
    source, target = colors(500, 0), colors(300, 1)
    matrix, offset = color_map(source, target)
    mapped = source @ matrix.T + offset
    torch.testing.assert_close(mapped.mean(dim=0), target.mean(dim=0))
    error = mapped.T.cov() - target.T.cov()
    assert error.norm() < NOISE_BIAS * target.T.cov().norm()


def test_a_map_to_its_own_colors_changes_little():
    source = colors(500, 0)
    matrix, offset = color_map(source, source)
    torch.testing.assert_close(source @ matrix.T + offset, source, atol=0.02, rtol=0)


def test_flat_colors_are_not_blown_up():
    """Their variance counts as NOISE, so no direction grows by more than this."""
    target = colors(300, 1)
    matrix, offset = color_map(torch.full((100, 3), 0.4), target)
    largest = torch.linalg.eigvalsh(target.T.cov()).max() / NOISE
    assert torch.linalg.matrix_norm(matrix, 2) < 1.01 * largest.sqrt()  # roundings
    mapped = matrix @ torch.full((3,), 0.4) + offset
    # roundings of a matrix of several hundreds
    torch.testing.assert_close(mapped, target.mean(dim=0), atol=1e-3, rtol=0)


def test_variation_gives_flat_objects_colors_to_stretch():
    splats = random_splats(400)
    splats = replace(splats, sh0=torch.zeros_like(splats.sh0))
    picked = torch.arange(400) < 300
    varied = vary_colors(splats, picked, seed=3)
    deviations = (varied.sh0[picked, 0] * SH_C0).std(dim=0)
    # single draws of a random pattern scatter around its deviation
    assert ((deviations > VARIATION / 2) & (deviations < 2 * VARIATION)).all()
    assert torch.equal(varied.sh0[~picked], splats.sh0[~picked])
    assert torch.equal(varied.sh0, vary_colors(splats, picked, seed=3).sh0)
    assert not torch.equal(varied.sh0, vary_colors(splats, picked, seed=4).sh0)


def test_colors_are_mapped_from_wherever_they_are_seen():
    splats = random_splats(100)
    splats = replace(splats, sh0=0.1 * splats.sh0, shN=0.1 * splats.shN)
    picked = torch.arange(100) < 60
    matrix, offset = 0.5 * torch.eye(3) + 0.05 * colors(3, 2), torch.tensor([0.1, 0.2, 0.3])
    mapped = map_colors(splats, picked, matrix, offset)
    dirs = torch.randn(100, 3, generator=torch.Generator().manual_seed(0))
    before = spherical_harmonics(3, dirs, splats.sh0, splats.shN)
    after = spherical_harmonics(3, dirs, mapped.sh0, mapped.shN)
    torch.testing.assert_close(after[picked], before[picked] @ matrix.T + offset)
    assert torch.equal(mapped.sh0[~picked], splats.sh0[~picked])
    assert torch.equal(mapped.shN[~picked], splats.shN[~picked])

"""Colours: mapped in closed form, led back to a painting's, and freed of an object's pattern."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from balls import (
    CAMERAS,
    COUNT,
    LIGHT,
    PICKED,
    SPLATS,
    WAYS,
    ball,
    cropped,
    dense_ball,
)
from scenes import rand, randn, random_splats
from stylesplat.evaluation.style import LOOK_TOLERANCE, off_palette
from stylesplat.imaging.color import (
    COLOR_NEAR,
    COLOR_NOISE,
    LUMA,
    build_palette,
    color_map,
    lab_from_rgb,
    map_colors,
    nearest_colors,
    transform_rgb,
)
from stylesplat.rendering.reference import Rasterizer
from stylesplat.scene.splats import SH_C0, rgb_from_sh0, sh0_from_rgb
from stylesplat.stylization.colors import (
    SHADING,
    VARIATION,
    add_hue_noise,
    away_from_outlines,
    blur_colors,
    hue_bands,
    limit_hue_detail,
    low_pass_colors,
    object_colors,
    project_to_palette,
    transfer_colors,
    transfer_two_bands,
)
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.views import ObjectView, find_boxes

NOISE_BIAS = 0.05  # the source's variances, 0.04 to 0.09, are raised by NOISE
GREY = torch.linspace(0, 1, 2000)[:, None].expand(2000, 3)
PATTERN = 0.25  # of the dense ball's colours, up and down
GENERATOR = torch.Generator().manual_seed(1)
NOISY = LIGHT + PATTERN * (2 * torch.randint(2, (COUNT, 1), generator=GENERATOR) - 1)
PATTERNED = sh0_from_rgb(NOISY)
LENGTH = 24.0  # pixels of the dense ball in its views
MEMORY = {"params": [1e9, 0.0], "ids": ["linear", "rasterised"]}


@pytest.fixture(scope="module", **MEMORY)
def views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    boxes = find_boxes(SPLATS, CAMERAS[:4], ball(0))
    return cropped(SPLATS, boxes, ball(0), network, zoom=2.0, max_memory=request.param)


@pytest.fixture(scope="module", **MEMORY)
def dense_views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    splats = dense_ball(LIGHT)
    boxes = find_boxes(splats, CAMERAS, PICKED)
    return cropped(splats, boxes, PICKED, network, max_memory=request.param)


def colors(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    axes = torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q
    spread = torch.tensor([0.3, 0.25, 0.2])[:, None] * axes
    return 0.5 + torch.randn(count, 3, generator=generator) @ spread


def test_mean_and_covariance_become_the_targets():
    source, target = colors(500, 0), colors(300, 1)
    there = transform_rgb(source, color_map(source, target))
    torch.testing.assert_close(there.mean(dim=0), target.mean(dim=0))
    error = there.T.cov() - target.T.cov()
    assert error.norm() < NOISE_BIAS * target.T.cov().norm()


def test_flat_colors_are_not_blown_up():
    """Their variance counts as NOISE, so no direction grows by more than this."""
    target = colors(300, 1)
    to_target = color_map(torch.full((100, 3), 0.4), target)
    largest = torch.linalg.eigvalsh(target.T.cov()).max() / COLOR_NOISE
    assert torch.linalg.matrix_norm(to_target[:, :3], 2) < 1.01 * largest.sqrt()  # roundings
    there = transform_rgb(torch.full((3,), 0.4), to_target)
    # roundings of a matrix of several hundreds
    torch.testing.assert_close(there, target.mean(dim=0), atol=1e-3, rtol=0)


def test_variation_gives_flat_objects_colors_to_stretch():
    means, flat = random_splats(300).means, torch.zeros(300, 3)
    varied = add_hue_noise(flat, means, seed=3)
    added = varied * SH_C0
    # single draws of a random pattern scatter around its deviation
    assert VARIATION / 2 < added.std(dim=0).mean() < 2 * VARIATION
    assert (added @ torch.tensor(LUMA)).abs().max() < 1e-6, "the same luminance"
    assert torch.equal(varied, add_hue_noise(flat, means, seed=3))
    assert not torch.equal(varied, add_hue_noise(flat, means, seed=4))


def test_colors_are_mapped_from_wherever_they_are_seen():
    splats = random_splats(100)
    splats = replace(splats, sh0=0.1 * splats.sh0, shN=0.1 * splats.shN)
    picked = torch.arange(100) < 60
    matrix, offset = 0.5 * torch.eye(3) + 0.05 * colors(3, 2), torch.tensor([0.1, 0.2, 0.3])
    change = torch.cat([matrix, offset[:, None]], dim=1)
    changed = map_colors(splats, picked, change)
    dirs = randn(100, 3)
    before = Rasterizer().spherical_harmonics(3, dirs, splats.sh0, splats.shN)
    after = Rasterizer().spherical_harmonics(3, dirs, changed.sh0, changed.shN)
    torch.testing.assert_close(after[picked], transform_rgb(before[picked], change))
    assert torch.equal(changed.sh0[~picked], splats.sh0[~picked])
    assert torch.equal(changed.shN[~picked], splats.shN[~picked])


def test_a_painting_leaves_its_own_colors_alone():
    style = rand(5000, 3)
    near = build_palette(style)
    assert (near.offset(style) == 0).float().mean() > 0.99  # cubes at the edge are cut off


def test_the_way_back_ends_near_the_painting_and_no_nearer():
    far = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9], [0.2, 0.9, 0.4]])
    ends = lab_from_rgb(far + build_palette(GREY).offset(far))
    grey = lab_from_rgb(GREY)
    away = (ends - grey[nearest_colors(ends, grey)]).norm(dim=1)
    # the way is straight in RGB, the distance is told in Lab
    assert ((away > COLOR_NEAR / 2) & (away < LOOK_TOLERANCE)).all(), away


def test_settling_brings_pixels_to_the_painting(views: list[ObjectView]):
    colors = SPLATS.sh0[ball(0), 0]
    before = off_palette(object_colors(colors, views), GREY)
    palette, beneath = build_palette(GREY), torch.arange(len(colors)) % 2 == 0
    settled = project_to_palette(colors, views, palette, beneath)
    after = off_palette(object_colors(settled, views), GREY)
    assert before > 0.9 and after < 0.5 * before
    assert off_palette(rgb_from_sh0(settled[beneath]).clamp(0, 1), GREY) == 0


def test_black_of_thin_lines_does_not_become_that_of_a_dark_side(dense_views: list[ObjectView]):
    means = dense_ball(LIGHT).means[PICKED]
    side = means[:, :1] < means[:, :1].quantile(0.3)
    shaded = PATTERNED * 0.3 - 1.2 * side
    lines = torch.full((48, 48, 3), 0.6)
    lines[:, ::4], lines[:, 2::4] = 0.05, 0.95
    deviation = 2.0

    def darkest(found: Tensor) -> float:
        broad = blur_colors(found, dense_views, deviation)
        return float(object_colors(broad, dense_views).mean(dim=1).quantile(0.02))

    def contrast(found: Tensor) -> float:
        broad = blur_colors(found, dense_views, deviation)
        detail = object_colors(found, dense_views) - object_colors(broad, dense_views)
        return float(detail.square().mean().sqrt())

    at_once = transfer_colors(shaded, lines.reshape(-1, 3), dense_views)
    in_bands = transfer_two_bands(shaded, [lines], dense_views, deviation, deviation)
    assert darkest(at_once) < 0.2 < 0.3 < darkest(in_bands)
    assert contrast(in_bands) > 1.3 * contrast(shaded), "detail gets more of the lines'"
    luma = rgb_from_sh0(in_bands) @ torch.tensor(LUMA)
    assert luma.min() > 0.04 and luma.max() < 0.96, "as dark and as bright as the lines at most"
    colored = shaded + randn(len(shaded), 3, seed=1)
    grey = rgb_from_sh0(transfer_two_bands(colored, [lines], dense_views, deviation, deviation))
    assert (grey - grey.mean(dim=1, keepdim=True)).square().mean().sqrt() < 0.02, "nor hues"


def test_hues_have_no_more_detail_than_the_style(dense_views: list[ObjectView]):
    noise = 0.1 * randn(COUNT, 3)
    noise = noise - (noise @ torch.tensor(LUMA))[:, None]
    noisy = sh0_from_rgb(LIGHT + noise)

    def detail(colors: torch.Tensor) -> torch.Tensor:
        """Deviation of hues in the size of a pixel, well inside the object."""
        bands = []
        for view in dense_views:
            inside = away_from_outlines(view.pixels)
            image = view.render(colors)
            hues = image - (image @ torch.tensor(LUMA))[..., None]
            bands.append(hue_bands(hues, inside)[1][:, inside])
        return torch.cat(bands, dim=1).std()

    flat, colorful = torch.full((40, 40, 3), 0.5), rand(40, 40, 3)
    limited = limit_hue_detail(noisy, dense_views, [flat], 1.0)
    assert detail(limited) < 0.6 * detail(noisy)
    half = limit_hue_detail(noisy, dense_views, [flat], 0.5)
    assert detail(limited) < detail(half) < detail(noisy)
    before, after = (object_colors(c, dense_views) @ torch.tensor(LUMA) for c in (noisy, limited))
    torch.testing.assert_close(before, after, atol=1e-3, rtol=0)
    unlimited = limit_hue_detail(noisy, dense_views, [colorful], 1.0)
    torch.testing.assert_close(unlimited, noisy, atol=1e-4, rtol=0)


def test_the_pattern_goes_and_a_part_of_the_light_stays(dense_views: list[ObjectView]):
    shown = WAYS[:, 2] > -0.3  # no camera looks from below
    half, full = (low_pass_colors(PATTERNED, dense_views, LENGTH, s) for s in (0.5, 1.0))
    calm = rgb_from_sh0(full)
    assert (calm - SHADING * LIGHT)[shown].std() < 0.3 * PATTERN
    centred = [values[shown, :1] - values[shown, :1].mean() for values in (LIGHT, calm)]
    assert float(torch.linalg.lstsq(*centred).solution) == pytest.approx(SHADING, abs=0.25)
    torch.testing.assert_close(half, (PATTERNED + full) / 2)


def test_blurring_leaves_what_small_renders_show(dense_views: list[ObjectView]):
    """Gaussians smaller than their pixels lose their noise; light stays."""
    shown = WAYS[:, 2] > 0
    full = rgb_from_sh0(blur_colors(PATTERNED, dense_views))
    assert (full - LIGHT)[shown].std() < 0.4 * PATTERN
    slope = torch.linalg.lstsq(LIGHT[shown, :1] - 0.5, full[shown, :1] - 0.5).solution
    assert float(slope) == pytest.approx(1, abs=0.2)


def test_parts_of_an_uneven_object_keep_their_borders(dense_views: list[ObjectView]):
    """Two halves of different tones: blurred they meet halfway at the border."""
    side = (WAYS[:, :1] > 0).float().expand(-1, 3)
    halves = sh0_from_rgb(0.3 + 0.4 * side)
    near = (WAYS[:, 0].abs() < 0.25) & (WAYS[:, 0].abs() > 0.1) & (WAYS[:, 2] > 0)
    left, right = near & (WAYS[:, 0] < 0), near & (WAYS[:, 0] > 0)
    steps = [
        float(rgb[right].mean() - rgb[left].mean())
        for rgb in (
            rgb_from_sh0(low_pass_colors(halves, dense_views, LENGTH, 1.0, unevenness))
            for unevenness in (0.0, 1.0)
        )
    ]
    assert steps[1] > 1.5 * steps[0] > 0
    assert steps[1] > 0.6 * 0.4

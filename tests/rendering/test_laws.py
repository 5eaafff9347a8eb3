"""What holds for any picture of any splat."""

import math
from dataclasses import replace

import pytest
import torch

from scenes import BACKENDS, device_of, randn, random_splats, two_cameras
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.reference import Rasterizer, rotation_matrices
from stylesplat.rendering.render import Backend, rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats, sh0_from_rgb

ANY = ["reference", *BACKENDS]
ROUNDING = 1e-4  # float32 sums in another order; one alpha cut that flips is 1/255


def render(splats: Splats, backend: Backend, cameras=None, **options) -> torch.Tensor:
    return both(splats, backend, cameras, **options)[0]


def both(
    splats: Splats, backend: Backend, cameras: Cameras | None = None, **options
) -> tuple[torch.Tensor, torch.Tensor]:
    """Image and coverage."""
    device = device_of(backend)
    cameras = two_cameras() if cameras is None else cameras
    image, alphas, _ = rasterize(splats.to(device), cameras, backend=backend, **options)
    return image.cpu(), alphas.cpu()


def assert_same_picture(image: torch.Tensor, other: torch.Tensor) -> None:
    """Up to float32 positions that differ in the last digits, which blur and cuts depend on."""
    difference = (image - other).abs()
    assert difference.mean() < ROUNDING
    assert difference.max() < 2 / 255


def single(mean: tuple[float, float, float], *, opacity: float, scale: float, rgb=(0.2, 0.4, 0.8)):
    """One round Gaussian of a colour."""
    return Splats(
        means=torch.tensor([mean]),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        scales=torch.full((1, 3), math.log(scale)),
        opacities=torch.logit(torch.tensor([opacity])),
        sh0=sh0_from_rgb(torch.tensor([[rgb]])),
        shN=torch.zeros(1, 0, 3),
    )


def standing(size: tuple[int, int] = (40, 30)) -> Cameras:
    """A camera at the origin that looks along z."""
    K = torch.tensor([[40.0, 0.0, size[0] / 2], [0.0, 40.0, size[1] / 2], [0.0, 0.0, 1.0]])
    return Cameras(torch.eye(4)[None], K[None], torch.tensor([size]), ("view.png",))


@pytest.mark.parametrize("backend", ANY)
def test_order_of_gaussians_is_irrelevant(backend: Backend):
    splats = random_splats()
    shuffled = splats[torch.randperm(len(splats), generator=torch.Generator().manual_seed(5))]
    assert (render(splats, backend) - render(shuffled, backend)).abs().max() < ROUNDING


@pytest.mark.parametrize("backend", ANY)
def test_moving_world_and_cameras_together_keeps_the_image(backend: Backend):
    splats, cameras = random_splats(sh_degree=0), two_cameras()
    rotation = rotation_matrices(torch.tensor([[0.9, 0.1, -0.3, 0.2]]))[0]
    shift = torch.tensor([0.3, -1.0, 0.5])
    w, (x, y, z) = 0.9, (0.1, -0.3, 0.2)
    left = torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    moved = replace(splats, means=splats.means @ rotation.T + shift, quats=splats.quats @ left.T)
    inverse = torch.eye(4)
    inverse[:3, :3], inverse[:3, 3] = rotation.T, -rotation.T @ shift
    cameras_moved = replace(cameras, viewmats=cameras.viewmats @ inverse)
    assert_same_picture(render(splats, backend), render(moved, backend, cameras_moved))


@pytest.mark.parametrize("backend", ANY)
def test_opacity_zero_shows_the_background(backend: Backend):
    splats = random_splats()
    clear = replace(splats, opacities=torch.full_like(splats.opacities, -20.0))
    background = torch.tensor([0.1, 0.5, 0.9])
    image = render(clear, backend, background=background)
    assert torch.equal(image, background.expand_as(image))


@pytest.mark.parametrize("backend", ANY)
def test_one_gaussian_has_the_peak_that_its_opacity_says(backend: Backend):
    camera = two_cameras()[:1]
    depth = float(camera.viewmats[0, 2, 3])
    pixel = torch.tensor([10.5, 20.5])  # the centre of column 10, row 20
    x, y = ((pixel - camera.Ks[0, :2, 2]) / camera.Ks[0, [0, 1], [0, 1]] * depth).tolist()
    splats = single((x, y, 0.0), opacity=0.6, scale=math.exp(-3))
    image = render(splats, backend, camera)[0]
    assert (image[20, 10] - 0.6 * torch.tensor([0.2, 0.4, 0.8])).abs().max() < 1e-5
    assert image[..., 0].argmax() == 20 * 70 + 10


@pytest.mark.parametrize("backend", ANY)
@pytest.mark.parametrize("rgb", [(0.0, -0.3, 0.4)])
def test_a_clamped_colour_has_the_gradients_that_raise_it_alone(backend: Backend, rgb: tuple):
    splats = single((0.0, 0.0, 2.0), opacity=0.6, scale=0.1, rgb=rgb)
    for sign in (-1.0, 1.0):
        sh0 = splats.sh0.clone().requires_grad_()
        image = render(replace(splats, sh0=sh0), backend, standing(), raise_clamped=True)
        assert (image >= 0).all() and image[..., 2].max() > 0.1
        (sign * image.sum()).backward()
        assert sh0.grad is not None
        red, green, blue = sh0.grad.flatten().tolist()
        assert blue == pytest.approx(sign * abs(blue)) and blue
        if sign < 0:
            assert red == pytest.approx(blue) and green == pytest.approx(blue)
        else:
            assert red == green == 0


@pytest.mark.parametrize("backend", ANY)
@pytest.mark.parametrize("corner", [(0, 0), (17, 9), (-8, 30)])
def test_a_crop_is_a_part_of_the_whole(backend: Backend, corner: tuple[int, int]):
    # Small Gaussians: of larger ones beside the image the shape is approximate, by its size.
    splats = random_splats()
    splats = replace(splats, scales=splats.scales - 2.5)
    camera, (left, top) = two_cameras()[1:], corner
    part = render(splats, backend, camera.crop(corner, (40, 30)))
    height = camera.size[1]
    whole = torch.nn.functional.pad(render(splats, backend, camera), (0, 0, 40, 40, 40, 40))
    whole = whole[:, 40 + top :, 40 + left :][:, :30, :40]
    rows, columns = slice(0, min(30, height - top)), slice(max(0, -left), 40)
    assert part[:, rows, columns].abs().max() > 0.5
    assert_same_picture(part[:, rows, columns], whole[:, rows, columns])


@pytest.mark.parametrize("backend", ANY)
def test_the_near_plane_is_not_seen_and_what_follows_is(backend: Backend):
    for depth, visible in ((-0.01, False), (0.0, False), (0.0099, False), (0.0101, True)):
        gaussian = single((0.0, 0.0, depth), opacity=0.9, scale=0.001)
        _, alphas = both(gaussian, backend, standing())
        assert bool(alphas.any()) == visible, depth


@pytest.mark.parametrize("backend", ANY)
def test_a_point_is_as_wide_as_the_low_pass_filter(backend: Backend):
    # a Gaussian without extent has variance EPS2D = 0.3 in the image
    point = single((0.0125, 0.0125, 1.0), opacity=0.9, scale=1e-9)  # the centre of pixel 20, 15
    _, alphas = both(point, backend, standing())
    row = alphas[0, 15, :, 0]
    assert row[20] == pytest.approx(0.9, abs=1e-4)
    assert float(row[21] / row[20]) == pytest.approx(math.exp(-0.5 / 0.3), rel=1e-3)
    assert float(row[22]) == 0  # 0.9 exp(-2 / 0.3) is below 1/255


@pytest.mark.parametrize("backend", ANY)
@pytest.mark.parametrize("opacity", [0.9, 0.3])
def test_an_antialiased_gaussian_fades_with_its_area(backend: Backend, opacity: float):
    """Its light is that of the area in the image, where others become no smaller than a pixel."""
    sums, areas = {True: [], False: []}, []
    for sigma in (0.06, 0.03, 0.015):  # 2.4, 1.2 and 0.6 pixels
        areas.append(2 * math.pi * (40 * sigma) ** 2)
        for antialiased in sums:
            ball = single((0.0125, 0.0125, 1.0), opacity=opacity, scale=sigma)
            _, alphas = both(replace(ball, antialiased=antialiased), backend, standing())
            sums[antialiased].append(float(alphas.sum()) / opacity)
    # what is fainter than 1/255 is not drawn; at 0.6 pixels the area is no longer that alone
    assert sums[True][:2] == pytest.approx(areas[:2], rel=0.1)
    assert sums[False][-1] > 1.7 * areas[-1] > sums[True][-1]
    tiny = single((0.0, 0.0, 1.0), opacity=0.9, scale=1e-4)
    assert not both(replace(tiny, antialiased=True), backend, standing())[1].any()
    assert both(tiny, backend, standing())[1].any()


@pytest.mark.parametrize("backend", ANY)
def test_the_image_is_linear_in_the_features(backend: Backend):
    splats = random_splats()
    one, other = randn(2, len(splats), 16, seed=2).to(device_of(backend))
    images = [render(splats, backend, features=f)[..., 3:] for f in (one, other, one - 3 * other)]
    # float32 sums of up to 200 terms of size 4
    torch.testing.assert_close(images[2], images[0] - 3 * images[1], atol=2e-5, rtol=0)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradients_of_spherical_harmonics(degree: int):
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        drawn = torch.randn(*shape, generator=generator, dtype=torch.float64)
        return drawn.requires_grad_()

    inputs = normal(4, 3), normal(4, 1, 3), normal(4, 15, 3)
    assert torch.autograd.gradcheck(lambda *t: Rasterizer().spherical_harmonics(degree, *t), inputs)


def test_cameras_of_two_sizes_are_refused():
    cameras = two_cameras()
    cameras.sizes[1, 0] = 71
    with pytest.raises(StyleSplatError, match="one size"):
        render(random_splats(3), "reference", cameras)

"""What holds for any picture of any splat."""

from dataclasses import replace

import pytest
import torch

from scenes import BACKENDS, random_splats, two_cameras
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.sh import rgb_from_sh0, sh0_from_rgb, sh_basis
from stylesplat.scene.splats import Splats

ANY = ["reference", *BACKENDS]
ROUNDING = 1e-4  # float32 sums in another order; one alpha cut that flips is 1/255


def render(splats: Splats, backend: Backend, cameras=None, **options) -> torch.Tensor:
    device = "cuda" if backend == "cuda" else "cpu"
    cameras = two_cameras() if cameras is None else cameras
    return rasterize(splats.to(device), cameras, backend=backend, **options)[0].cpu()


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
    # Blur and cuts depend on float32 positions that now differ in the last digits.
    difference = render(splats, backend) - render(moved, backend, cameras_moved)
    assert difference.abs().mean() < ROUNDING
    assert difference.abs().max() < 2 / 255


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
    ray = (pixel - camera.Ks[0, :2, 2]) / camera.Ks[0, [0, 1], [0, 1]]
    mean = torch.tensor([[*(ray * depth).tolist(), 0.0]])
    splats = Splats(
        means=mean,
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        scales=torch.full((1, 3), -3.0),
        opacities=torch.logit(torch.tensor([0.6])),
        sh0=sh0_from_rgb(torch.tensor([[[0.2, 0.4, 0.8]]])),
        shN=torch.zeros(1, 0, 3),
    )
    image = render(splats, backend, camera)[0]
    assert (image[20, 10] - 0.6 * torch.tensor([0.2, 0.4, 0.8])).abs().max() < 1e-5
    assert image[..., 0].argmax() == 20 * 70 + 10


@pytest.mark.parametrize("backend", ANY)
def test_nothing_to_see_is_an_empty_image(backend: Backend):
    nothing = random_splats(5)[torch.zeros(5, dtype=torch.bool)]
    assert not render(nothing, backend).any()


def test_sh_basis_is_orthonormal():
    # Monte Carlo over the sphere: 200,000 directions leave an error of about 1 / sqrt(200,000).
    generator = torch.Generator().manual_seed(0)
    dirs = torch.randn(200_000, 3, generator=generator, dtype=torch.float64)
    basis = sh_basis(3, torch.nn.functional.normalize(dirs, dim=-1))
    gram = basis.T @ basis / len(dirs) * 4 * torch.pi
    assert (gram - torch.eye(16)).abs().max() < 0.02


def test_sh0_round_trip():
    rgb = torch.rand(7, 3, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(rgb_from_sh0(sh0_from_rgb(rgb)), rgb, atol=1e-6)


def test_cameras_of_two_sizes_are_refused():
    cameras = two_cameras()
    cameras.sizes[1, 0] = 71
    with pytest.raises(StyleSplatError, match="one size"):
        render(random_splats(3), "reference", cameras)

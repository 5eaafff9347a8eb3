import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from stylesplat.metrics.images import psnr, ssim


def noise(seed: int = 0) -> torch.Tensor:
    return torch.rand(40, 50, 3, generator=torch.Generator().manual_seed(seed))


def test_psnr_of_a_known_error():
    image = torch.zeros(4, 5, 3)
    assert psnr(image, image + 0.1).item() == pytest.approx(20.0, abs=1e-4)
    assert psnr(image, image).item() == pytest.approx(120)


def test_ssim_is_one_only_for_equal_images():
    image = noise()
    assert ssim(image, image).item() == pytest.approx(1.0, abs=1e-6)
    assert ssim(image, noise(1)).item() < 0.2


def test_ssim_matches_scipy():
    x, y = noise().double(), (0.7 * noise() + 0.3 * noise(1)).double()

    def blur(image: np.ndarray) -> np.ndarray:
        return gaussian_filter(image, 1.5, radius=5, mode="constant", axes=(0, 1))

    a, b = x.numpy(), y.numpy()
    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covar = blur(a * b) - mean_a * mean_b
    expected = ((2 * mean_a * mean_b + 1e-4) * (2 * covar + 9e-4)) / (
        (mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4)
    )
    assert ssim(x, y).item() == pytest.approx(expected.mean(), abs=1e-6)  # the window is float32

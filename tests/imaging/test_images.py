import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from scenes import rand
from stylesplat.imaging.similarity import psnr, ssim


def test_psnr_of_a_known_error():
    image = torch.zeros(4, 5, 3)
    assert psnr(image, image + 0.1).item() == pytest.approx(20.0, abs=1e-4)
    assert psnr(image, image).item() == pytest.approx(120)


def test_ssim_matches_scipy():
    assert ssim(rand(40, 50, 3), rand(40, 50, 3)).item() == pytest.approx(1.0, abs=1e-6)
    x, y = (
        rand(40, 50, 3).double(),
        (0.7 * rand(40, 50, 3) + 0.3 * rand(40, 50, 3, seed=1)).double(),
    )

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

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from stylesplat.demo.style_pictures import burning_tide, swirling_night

PAINTINGS = (swirling_night, burning_tide)


def coherence(image: np.ndarray) -> float:
    """Mean anisotropy of the structure tensor over patches the size of a stroke: 0 to 1."""
    grey = cv2.GaussianBlur(image.mean(axis=-1), (0, 0), 1.5)
    dy, dx = np.gradient(grey)
    xx, yy, xy = (cv2.GaussianBlur(t, (0, 0), 6) for t in (dx * dx, dy * dy, dx * dy))
    return float((np.hypot(xx - yy, 2 * xy) / (xx + yy + 1e-9)).mean())


@pytest.mark.parametrize("paint", PAINTINGS)
def test_strokes_have_a_direction_that_noise_lacks(paint: Callable[[int], np.ndarray]):
    noise = np.random.default_rng(0).uniform(0, 255, (400, 400, 3))
    blurred = cv2.GaussianBlur(noise, (0, 0), 3)
    assert coherence(paint(0)) > coherence(noise) + 0.2
    assert coherence(paint(0)) > coherence(blurred) + 0.1


@pytest.mark.parametrize("paint", PAINTINGS)
def test_a_painting_is_the_same_again_and_differs_by_seed(paint: Callable[[int], np.ndarray]):
    assert np.array_equal(paint(2), paint(2))
    assert not np.array_equal(paint(2), paint(3))


def test_paintings_have_contrast_and_palettes_of_their_own():
    night, tide = (p(0).astype(float) for p in PAINTINGS)
    for painting in (night, tide):
        assert painting.shape == (576, 576, 3)
        assert painting.mean(axis=-1).std() > 35
    red_minus_blue = [(p[..., 0] - p[..., 2]).mean() for p in (night, tide)]
    assert red_minus_blue[0] < -30 and red_minus_blue[1] > 30

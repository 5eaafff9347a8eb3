"""Undistortion is checked against COLMAP's own, and against the geometry it stands for."""

import numpy as np
import pycolmap
import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import Lens

WIDTH, HEIGHT = 160, 120
LENSES = {
    "SIMPLE_RADIAL": [140.0, 78.0, 61.0, 0.12],
    "RADIAL": [140.0, 78.0, 61.0, 0.1, -0.05],
    "OPENCV": [140.0, 145.0, 78.0, 61.0, 0.12, -0.05, 0.004, -0.003],
    "OPENCV_FISHEYE": [100.0, 104.0, 78.0, 61.0, 0.04, -0.01, 0.003, -0.001],
    "FULL_OPENCV": [140.0, 145.0, 78.0, 61.0, 0.1, -0.05, 0.003, 0.002, 0.01, 0.0, 0.0, 0.0],
}
distorted = pytest.mark.parametrize("model", LENSES)


def lens(model: str) -> Lens:
    return Lens(model, WIDTH, HEIGHT, tuple(LENSES[model]))


@distorted
def test_same_as_colmap(model: str):
    taken = lens(model)
    coarse = np.random.default_rng(0).integers(0, 256, (HEIGHT // 8, WIDTH // 8, 3), np.uint8)
    image = np.kron(coarse, np.ones((8, 8, 1), np.uint8))
    bitmap, camera = pycolmap.undistort_image(
        pycolmap.UndistortCameraOptions(), pycolmap.Bitmap.from_array(image), taken.camera
    )
    pinhole = taken.pinhole()
    assert (pinhole.size, pinhole.params) == ((camera.width, camera.height), tuple(camera.params))
    # OpenCV places samples at multiples of 1/32 pixel: 4 of 255 levels at an edge of full contrast
    inside = (slice(1, -1), slice(1, -1))
    ours = taken.undistort(image)[inside].astype(int)
    assert np.abs(ours - bitmap.to_array()[inside]).max() <= 5


@distorted
def test_nearest_makes_no_new_values(model: str):
    ids = np.kron(np.array([[1, 70000], [300, 2]], np.int32), np.ones((60, 80), np.int32))
    result = lens(model).undistort(ids, nearest=True)
    assert result.dtype == np.int32
    assert set(np.unique(result)) == {1, 2, 300, 70000}


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_PINHOLE", (50.0, 30.0, 20.0)),
        ("PINHOLE", (50.0, 51.0, 30.0, 20.0)),
        ("OPENCV", (50.0, 51.0, 30.0, 20.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_without_distortion_nothing_changes(model: str, params: tuple[float, ...]):
    taken = Lens(model, 64, 48, params)
    image = np.arange(64 * 48, dtype=np.int32).reshape(48, 64)
    assert taken.pinhole() == taken
    assert taken.undistort(image) is image
    assert (taken.K[0, 0], taken.K[0, 2], taken.K[1, 2]) == (50, 30, 20)


@pytest.mark.parametrize(
    ("model", "params", "match"),
    [
        ("PINHOLE", [50.0, float("nan"), 30.0, 20.0], "impossible numbers"),
        ("PINHOLE", [50.0, 50.0], "impossible numbers"),
        ("PINHOLE", [50.0, -1.0, 30.0, 20.0], "no focal length"),
        ("EQUIRECTANGULAR", None, "cannot be undistorted"),
    ],
)
def test_impossible_cameras(model: str, params: list[float] | None, match: str):
    camera = pycolmap.Camera.create_from_model_name(1, model, 50.0, 64, 48)
    if params is not None:
        camera.params = params
    with pytest.raises(StyleSplatError, match=match):
        Lens.from_colmap(camera)


def test_distortions_after_which_nothing_is_seen():
    lens = Lens("FULL_OPENCV", 64, 48, (60.0, 62.0, 31.0, 0.0, 0.05, 0.05, -1e3, *[0.05] * 5))
    with pytest.raises(StyleSplatError, match="impossible distortion"):
        lens.pinhole()

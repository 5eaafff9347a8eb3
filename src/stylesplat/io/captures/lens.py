"""Camera models with distortion, and the way from their photos to pinhole photos."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap

MAX_SIDE = 2**20  # pixels; COLMAP walks along the rim of what it undistorts
# Sampling maps are made and kept by bands of rows. A pixel takes about 100 bytes while one is made
# and 8 after that: less than half a GiB and, for all that are kept, one
BAND = 2**22
BANDS_KEPT = 32
LENSES_KEPT = 1024  # some captures have one a photo
MAX_PARAM = 1e9  # of any parameter, be it a focal length in pixels
MIN_FOCAL = 1e-3  # pixels
LOOKED_AT = 16  # pixels a side of the undistorted photo
LEAST_SEEN = 0.1  # of them must show something; COLMAP crops so that all do


@dataclass(frozen=True)
class Lens:
    """A camera model of COLMAP: hashable, and measured in pixels with centres at +0.5."""

    model: str
    """COLMAP's name of the model."""
    width: int
    """Of the photo."""
    height: int
    """Of the photo."""
    params: tuple[float, ...]
    """Focal lengths, principal point and distortion, in COLMAP's order."""

    @classmethod
    def from_colmap(cls, camera: pycolmap.Camera) -> "Lens":
        """Take over a camera, checking that it can be one.

        Raises:
            StyleSplatError: If a number is missing, not finite or not positive where it has to
                be, or if the camera is a panorama's.
        """
        name, size = camera.model_name, (camera.width, camera.height)
        sane = camera.verify_params() and all(abs(x) <= MAX_PARAM for x in camera.params)
        if not sane or not 1 <= min(size) <= max(size) <= MAX_SIDE:
            raise StyleSplatError(f"A {name} camera has impossible numbers. Pose the photos again.")
        if not camera.is_perspective():
            raise StyleSplatError(
                f"Cameras of the model {name} cannot be undistorted. Use photos of a lens."
            )
        if min(camera.focal_length_x, camera.focal_length_y) < MIN_FOCAL:
            raise StyleSplatError(f"A {name} camera has no focal length. Pose the photos again.")
        return cls(name, camera.width, camera.height, tuple(map(float, camera.params)))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width, self.height

    @property
    def camera(self) -> pycolmap.Camera:
        """The same for pycolmap."""
        return pycolmap.Camera(
            model=self.model, width=self.width, height=self.height, params=self.params
        )

    @property
    def K(self) -> Float[Tensor, "3 3"]:
        """Intrinsics, which describe the lens completely if it is a pinhole."""
        return torch.from_numpy(self.camera.calibration_matrix()).float()

    @property
    def is_pinhole(self) -> bool:
        """Whether there is no distortion."""
        return self.camera.is_undistorted()

    def scaled(self, width: int, height: int) -> "Lens":
        """The same lens for a photo of another size."""
        camera = self.camera
        camera.rescale(width, height)
        return Lens.from_colmap(camera)

    def pinhole(self) -> "Lens":
        """The lens that the undistorted photo seems to be taken with (COLMAP's choice of crop).

        Raises:
            StyleSplatError: If it would see next to nothing of the photo.
        """
        return self if self.is_pinhole else _pinhole(self)

    def undistort(
        self, pixels: Shaped[np.ndarray, "h w *D"], *, nearest: bool = False
    ) -> Shaped[np.ndarray, "H W *D"]:
        """What `pinhole()` would have seen, given this lens's photo; 0 where it saw nothing."""
        if self.is_pinhole:
            return pixels
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        width, height = self.pinhole().size
        seen = np.empty((height, width, *pixels.shape[2:]), pixels.dtype)
        for rows in bands(width, height):
            maps = _sampling_map(self, rows.start, rows.stop)
            seen[rows] = cv2.remap(pixels, *maps, how, borderMode=cv2.BORDER_CONSTANT)
        return seen


def bands(width: int, height: int) -> Iterator[slice]:
    """The rows of a picture, so many at a time that copies of them take little memory."""
    rows = max(1, BAND // width)
    return (slice(start, min(start + rows, height)) for start in range(0, height, rows))


@lru_cache(maxsize=LENSES_KEPT)
def _pinhole(lens: Lens) -> Lens:
    options = pycolmap.UndistortCameraOptions()
    pinhole = Lens.from_colmap(pycolmap.undistort_camera(options, lens.camera))
    x, y = np.meshgrid(*(np.linspace(0.5, side - 0.5, LOOKED_AT) for side in pinhole.size))
    places = _places(np.stack([x.ravel(), y.ravel()], axis=1), pinhole, lens)
    if ((places > 0) & (places < lens.size)).all(axis=1).mean() < LEAST_SEEN:
        raise StyleSplatError(
            f"A {lens.model} camera has an impossible distortion: undistorted, its photos are "
            "black. Pose the photos again."
        )
    return pinhole


def _places(
    pixels: Float[np.ndarray, "P 2"], pinhole: Lens, lens: Lens
) -> Float[np.ndarray, "P 2"]:
    """Where the distorted photo has what a pinhole photo has at some places."""
    rays = np.asarray(pinhole.camera.cam_from_img(pixels))
    rays = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=1)  # [P, 3]
    return np.asarray(lens.camera.img_from_cam(rays))


@lru_cache(maxsize=BANDS_KEPT)
def _sampling_map(
    lens: Lens, start: int, stop: int
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """For some rows of the pinhole photo the pixels' places in the distorted, as OpenCV counts."""
    pinhole = lens.pinhole()
    rows, columns = np.mgrid[start:stop, : pinhole.width] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    places = _places(pixels, pinhole, lens).reshape(*rows.shape, 2) - 0.5
    with np.errstate(over="ignore", invalid="ignore"):  # far outside
        return places[..., 0].astype(np.float32), places[..., 1].astype(np.float32)

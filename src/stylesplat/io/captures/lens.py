"""Camera models with distortion, and how their photos become pinhole photos."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.images import row_bands
from stylesplat.photo_libraries import cv2, pycolmap

LENS_MAX_SIDE = 2**20  # pixels; COLMAP walks along the border of what it undistorts
# Sampling maps are made and cached by bands of rows. A pixel takes about 100 bytes while one is
# made and 8 after that: less than half a GiB, and one for all that are cached
MAPS_CACHED = 32
LENSES_CACHED = 1024  # some captures have one lens a photo
MAX_PARAM = 1e9  # of any parameter, also a focal length in pixels
MIN_FOCAL = 1e-3  # pixels
CHECK_GRID = 16  # points along each side of the undistorted photo that are looked up
MIN_VISIBLE = 0.1  # share of them that must lie in the photo; COLMAP crops so that all do


@dataclass(frozen=True)
class Lens:
    """A camera model of COLMAP: hashable, in pixels with centres at +0.5."""

    model: str
    """COLMAP's name of the model."""
    width: int
    height: int
    params: tuple[float, ...]
    """Focal lengths, principal point and distortion, in COLMAP's order."""

    @classmethod
    def from_colmap(cls, camera: "pycolmap.Camera") -> "Lens":
        """Convert a camera. Raises a StyleSplatError for numbers that no perspective lens has."""
        name, size = camera.model_name, (camera.width, camera.height)
        sane = camera.verify_params() and all(abs(x) <= MAX_PARAM for x in camera.params)
        if not sane or not 1 <= min(size) <= max(size) <= LENS_MAX_SIDE:
            raise StyleSplatError(f"A {name} camera has impossible numbers. Pose the photos again.")
        if not camera.is_perspective():
            raise StyleSplatError(
                f"Cameras of the model {name} cannot be undistorted. Use photos of a lens."
            )
        if min(camera.focal_length_x, camera.focal_length_y) < MIN_FOCAL:
            raise StyleSplatError(f"A {name} camera has no focal length. Pose the photos again.")
        return cls(name, camera.width, camera.height, tuple(map(float, camera.params)))

    @classmethod
    def create(cls, model: str, width: int, height: int, params: Sequence[float]) -> "Lens":
        """A checked lens. Raises a StyleSplatError for what is none, as `from_colmap` does."""
        known = {*pycolmap.CameraModelId.__members__} - {"INVALID"}
        if model not in known:
            raise StyleSplatError(
                f"There is no camera model {shorten(model)}. Convert it to one of COLMAP's, such "
                "as OPENCV."
            )
        if not 1 <= min(width, height) <= max(width, height) <= LENS_MAX_SIDE:
            raise StyleSplatError(
                f"A photo cannot have {width}x{height} pixels. Pose the photos again."
            )
        camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
        return cls.from_colmap(camera)

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height

    @property
    def camera(self) -> "pycolmap.Camera":
        return pycolmap.Camera(
            model=self.model, width=self.width, height=self.height, params=self.params
        )

    @property
    def K(self) -> Float[Tensor, "3 3"]:
        return torch.from_numpy(self.camera.calibration_matrix()).float()

    @property
    def is_pinhole(self) -> bool:
        return self.camera.is_undistorted()

    def scaled(self, width: int, height: int) -> "Lens":
        camera = self.camera
        camera.rescale(width, height)
        return Lens.from_colmap(camera)

    def pinhole(self) -> "Lens":
        """The lens of the undistorted photo, cropped as COLMAP does."""
        return self if self.is_pinhole else _pinhole(self)

    def undistort(
        self, pixels: Shaped[np.ndarray, "h w *D"], *, nearest: bool = False
    ) -> Shaped[np.ndarray, "H W *D"]:
        """The photo that `pinhole()` would have taken; 0 where the lens saw nothing."""
        if self.is_pinhole:
            return pixels
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        width, height = self.pinhole().size
        undistorted = np.empty((height, width, *pixels.shape[2:]), pixels.dtype)
        for rows in row_bands(width, height):
            maps = _sampling_map(self, rows.start, rows.stop)
            undistorted[rows] = cv2.remap(pixels, *maps, how, borderMode=cv2.BORDER_CONSTANT)
        return undistorted


@lru_cache(maxsize=LENSES_CACHED)
def _pinhole(lens: Lens) -> Lens:
    options = pycolmap.UndistortCameraOptions()
    pinhole = Lens.from_colmap(pycolmap.undistort_camera(options, lens.camera))
    x, y = np.meshgrid(*(np.linspace(0.5, side - 0.5, CHECK_GRID) for side in pinhole.size))
    points = places_in(lens, np.stack([x.ravel(), y.ravel()], axis=1), pinhole)
    if ((points > 0) & (points < lens.size)).all(axis=1).mean() < MIN_VISIBLE:
        raise StyleSplatError(
            f"A {lens.model} camera has an impossible distortion: undistorted, its photos are "
            "black. Pose the photos again."
        )
    return pinhole


def places_in(
    lens: Lens, pixels: Float[np.ndarray, "P 2"], other: Lens
) -> Float[np.ndarray, "P 2"]:
    """Where a lens shows what another one shows at these pixels."""
    rays = np.asarray(other.camera.cam_from_img(pixels))
    rays = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=1)  # [P, 3]
    return np.asarray(lens.camera.img_from_cam(rays))


@lru_cache(maxsize=MAPS_CACHED)
def _sampling_map(
    lens: Lens, start: int, stop: int
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """For rows of the pinhole photo, the x and y of their source pixels, centres at integers."""
    pinhole = lens.pinhole()
    rows, columns = np.mgrid[start:stop, : pinhole.width] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    points = places_in(lens, pixels, pinhole).reshape(*rows.shape, 2) - 0.5
    with np.errstate(over="ignore", invalid="ignore"):  # far outside
        return points[..., 0].astype(np.float32), points[..., 1].astype(np.float32)

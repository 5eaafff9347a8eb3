"""Renders fitted to photos without being judged by what they were fitted on: half by half."""

from collections.abc import Collection
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.rendering.render import rasterize, render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.training.adam import Moments, adam_step
from stylesplat.training.initialize import scene_extent
from stylesplat.training.losses import photometric_loss
from stylesplat.training.per_photo import (
    apply_color_map,
    blown_out_target,
    fit_color_map,
    shift_cameras,
)

STEPS = 40  # of fitting a camera
FIRST_RATE, LAST_RATE = 2e-3, 1e-4  # radians, and shares of the cameras' distance, a step


@dataclass(frozen=True)
class Fits:
    """What a photo has of its own, as in the training that made the splat."""

    colors: bool = False
    """Exposure and white balance."""
    pose: bool = False
    """A camera beside the given one."""
    unit: float = 1.0
    """Of length, for shifts of cameras."""

    @property
    def names(self) -> list[str]:
        """What is fitted, as scenes note it."""
        return [name for name in ("colors", "pose") if getattr(self, name)]


def fits_of(names: Collection[str], cameras: Cameras) -> Fits:
    """What `Fits.names` says, for photos of a scene with these cameras."""
    return Fits("colors" in names, "pose" in names, scene_extent(cameras))


@torch.no_grad()
def fitted_render(
    splats: Splats, camera: Cameras, photo: Float[Tensor, "H W 3"], fits: Fits
) -> Float[Tensor, "H W 3"]:
    """The render for a photo, each half of it fitted on the other half of the photo.

    Args:
        splats: The Gaussians.
        camera: Of the photo.
        photo: In 0..1, over black.
        fits: What to fit.
    """
    middle = camera.size[0] // 2
    left, right = slice(None, middle), slice(middle, None)
    halves = [_fitted_on(splats, camera, photo, seen, fits) for seen in (right, left)]
    return torch.cat([halves[0][:, left], halves[1][:, right]], dim=1)


def _fitted_on(
    splats: Splats, camera: Cameras, photo: Tensor, seen: slice, fits: Fits
) -> Float[Tensor, "H W 3"]:
    """The whole render, fitted on some columns of the photo."""
    if fits.pose:
        camera = _found(splats, camera, photo, seen, fits)
    image, alpha = render(splats, camera)
    if not fits.colors:
        return image
    change = fit_color_map(image[:, seen], alpha[:, seen], photo[:, seen])
    return apply_color_map(image, alpha, change)


def _found(splats: Splats, camera: Cameras, photo: Tensor, seen: slice, fits: Fits) -> Cameras:
    """The camera moved to where some columns of its photo look as rendered."""
    target = photo[:, seen]
    near = crop(camera, (seen.start or 0, 0), (target.shape[1], target.shape[0]))
    params = {"pose_shifts": photo.new_zeros(1, 6).requires_grad_()}
    moments = Moments.zeros(params)
    for step in range(STEPS):
        params["pose_shifts"].grad = None
        with torch.enable_grad():
            image, alpha, _ = rasterize(
                splats, shift_cameras(near, params["pose_shifts"], fits.unit)
            )
            image = image[0]
            if fits.colors:
                change = fit_color_map(image.detach(), alpha[0].detach(), target)
                image = apply_color_map(image, alpha[0], change)
            photometric_loss(image, blown_out_target(image, target))[0].backward()
        rate = FIRST_RATE * (LAST_RATE / FIRST_RATE) ** (step / (STEPS - 1))
        adam_step(params, moments, {"pose_shifts": rate}, step + 1)
    return shift_cameras(camera, params["pose_shifts"].detach(), fits.unit)

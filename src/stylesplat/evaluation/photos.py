"""How close renders are to photos, also of photos with an exposure or a pose of their own."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.segmentation import label_metrics
from stylesplat.metrics.psnr import psnr
from stylesplat.metrics.ssim import ssim
from stylesplat.progress import track
from stylesplat.rendering.render import rasterize, render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
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

MEASURED = 8  # views of an import
STEPS = 40  # of fitting a camera
FIRST_RATE, LAST_RATE = 2e-3, 1e-4  # radians, and shares of the cameras' distance, a step


@dataclass(frozen=True)
class Fits:
    """What is fitted to each photo, as in the training of the splat."""

    colors: bool = False
    """Exposure and white balance."""
    pose: bool = False
    """A shift of the camera."""
    unit: float = 1.0
    """The unit of length for shifts of cameras."""

    @property
    def names(self) -> list[str]:
        """The names of the fits, as scenes record them."""
        return [name for name in ("colors", "pose") if getattr(self, name)]


NO_FITS = Fits()


def measured_rows(capture: Capture) -> list[int]:
    """Rows of the views of an imported scene that are compared; none of them is held out."""
    return evenly(range(len(capture)), MEASURED)


@torch.no_grad()
def evaluate_views(
    splats: Splats, capture: Capture, rows: Sequence[int], *, fits: Fits = NO_FITS
) -> dict[str, Any]:
    """Compare renders with photos, and rendered label maps with the given ones.

    Where photos are transparent, black is compared with what is rendered.

    Args:
        splats: The Gaussians.
        capture: Photos and their cameras.
        rows: The views to compare, usually the held-out ones.
        fits: What is fitted to each photo. The left half is fitted on the right one, and the other
            way round.

    Returns:
        `psnr` and `ssim`, averaged over the views; where something is fitted, also
        `psnr_unfitted` and `ssim_unfitted`, without that. If the splats have identities and these
        views have label maps, also `iou` and `boundary_iou` by label id, and their means over the
        objects, `miou` and `boundary_miou`. Pixels of ids that the splats do not know, as no
        photo that was trained on shows them, are left out, and the ids listed in `unknown_ids`.

    Raises:
        StyleSplatError: If `rows` is empty.
    """
    if not rows:
        raise StyleSplatError(
            "There are no held-out views to evaluate. Train with `--test-every 8`."
        )
    scores = []
    for row in track(rows, "comparing with photos"):
        photo = capture.photos[row].to(splats.means) / 255
        image = render(splats, capture.cameras[row])[0]
        images = [image]
        if fits.names:
            images.append(fitted_render(splats, capture.cameras[row], photo, fits))
        scores.append(torch.stack([_closeness(each.clamp(0, 1), photo) for each in images]))
    means = torch.stack(scores).mean(dim=0)
    metrics: dict[str, Any] = dict(zip(("psnr", "ssim"), means[-1].tolist(), strict=True))
    if fits.names:
        names = ("psnr_unfitted", "ssim_unfitted")
        metrics |= dict(zip(names, means[0].tolist(), strict=True))
    return metrics | label_metrics(splats, capture, rows)


def _closeness(image: Float[Tensor, "H W 3"], photo: Float[Tensor, "H W 3"]) -> Float[Tensor, "2"]:
    return torch.stack([psnr(image, photo), ssim(image, photo)])


def fits_of(names: Collection[str], cameras: Cameras) -> Fits:
    """The fits with these names, for the photos of these cameras."""
    return Fits("colors" in names, "pose" in names, scene_extent(cameras))


@torch.no_grad()
def fitted_render(
    splats: Splats, camera: Cameras, photo: Float[Tensor, "H W 3"], fits: Fits
) -> Float[Tensor, "H W 3"]:
    """Render the view of a photo over black, each half fitted on the other half of the photo."""
    middle = camera.size[0] // 2
    left, right = slice(None, middle), slice(middle, None)
    halves = [_fitted_on(splats, camera, photo, seen, fits) for seen in (right, left)]
    return torch.cat([halves[0][:, left], halves[1][:, right]], dim=1)


def _fitted_on(
    splats: Splats, camera: Cameras, photo: Tensor, seen: slice, fits: Fits
) -> Float[Tensor, "H W 3"]:
    """Render the whole view, fitted on some columns of the photo."""
    if fits.pose:
        camera = _found(splats, camera, photo, seen, fits)
    image, alpha = render(splats, camera)
    if not fits.colors:
        return image
    change = fit_color_map(image[:, seen], alpha[:, seen], photo[:, seen])
    return apply_color_map(image, alpha, change)


def _found(splats: Splats, camera: Cameras, photo: Tensor, seen: slice, fits: Fits) -> Cameras:
    """Shift a camera so that the render of some columns matches its photo."""
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

"""Renders against photos, and rendered label maps against given ones."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import object_iou, psnr, ssim
from stylesplat.io.captures.photos import PHOTO_OPAQUE
from stylesplat.progress import say, track
from stylesplat.rendering.render import rasterize, render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Capture, Labels
from stylesplat.scene.outliers import scene_extent
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import render_labels
from stylesplat.training.adam import Moments, adam_step
from stylesplat.training.config import LEVELS, PhotoBackground
from stylesplat.training.losses import photometric_loss
from stylesplat.training.per_photo import (
    apply_color_map,
    blown_out_target,
    fit_color_map,
    shift_cameras,
)

PHOTO_METRICS = "psnr", "ssim", "object_psnr"
IMPORT_VIEWS = 8  # views of an imported scene that are compared
PHOTO_STEPS = 40  # of fitting a camera
FIRST_RATE, LAST_RATE = 2e-3, 1e-4  # radians, and shares of the cameras' distance, a step


@dataclass(frozen=True)
class Fits:
    """What is fitted to each photo, as in the training of the splat."""

    colors: bool = False
    pose: bool = False
    unit: float = 1.0
    """The unit of length for shifts of cameras."""

    @property
    def names(self) -> list[str]:
        return [name for name in ("colors", "pose") if getattr(self, name)]


NO_FITS = Fits()


def fits_of(names: Collection[str], cameras: Cameras) -> Fits:
    """The fits with these names, for the photos of these cameras."""
    return Fits("colors" in names, "pose" in names, scene_extent(cameras))


def measured_rows(capture: Capture) -> list[int]:
    """Rows of the views of an imported scene that are compared; none of them is held out."""
    return evenly_spaced(range(len(capture)), IMPORT_VIEWS)


@torch.no_grad()
def evaluate_views(
    splats: Splats,
    capture: Capture,
    rows: Sequence[int],
    *,
    fits: Fits = NO_FITS,
    background: PhotoBackground = "random",
) -> dict[str, Any]:
    """Compare renders with photos, and rendered label maps with the given ones.

    Transparent photos are compared over black, or white if they were trained on over white; pixels
    that the capture's masks leave out are not compared. What is fitted to each photo is fitted to
    its left half on the right one, and the other way round.

    Returns `psnr` and `ssim`, averaged over the views; of cut-outs also `object_psnr`, over opaque
    pixels alone, since transparent ones are easy to get right; with fits, also `psnr_unfitted` and
    `ssim_unfitted`; none of them if the masks leave nothing. If the splats have identities and
    these views have label maps, also `iou` and `boundary_iou` by label id, and their means over the
    objects, `miou` and `boundary_miou`. Pixels of ids that the splats do not know are left out, and
    these ids are listed in `unknown_ids`.
    """
    if not rows:
        raise StyleSplatError(
            "There are no held-out views to evaluate. Train with `--test-every 8`."
        )
    scores = []
    for row in track(rows, "comparing with photos"):
        valid = capture.valid(row)
        if valid is None or valid.any():
            scores.append(_photo_scores(splats, capture, row, fits, LEVELS.get(background, 0.0)))
    if not scores:
        say("The masks of the held-out photos leave no pixel to measure.")
        return _label_metrics(splats, capture, rows)
    means = torch.tensor(scores, dtype=torch.float64).nanmean(dim=0).tolist()
    metrics: dict[str, Any] = dict(zip(PHOTO_METRICS, means[-1], strict=True))
    if math.isnan(metrics["object_psnr"]):
        del metrics["object_psnr"]
    if fits.names:
        metrics |= zip(("psnr_unfitted", "ssim_unfitted"), means[0][:2], strict=True)
    return metrics | _label_metrics(splats, capture, rows)


def _photo_scores(
    splats: Splats, capture: Capture, row: int, fits: Fits, level: float
) -> list[list[float]]:
    """`PHOTO_METRICS` of a view, without and perhaps with fits; `level` is behind a cut-out.

    What is not there is NaN.
    """
    photo, camera = capture.photos[row].to(splats.means) / 255, capture.cameras[row]
    opacity, valid = capture.alpha(row), capture.valid(row)
    valid = None if valid is None else valid.to(splats.device)
    views = [render(splats, camera)]
    if fits.names:
        views.append(fitted_render(splats, camera, photo, fits, valid))
    if opacity is not None:
        views = [(image + (1 - alpha) * level, alpha) for image, alpha in views]
        photo = photo + (1 - opacity[..., None].to(photo) / 255) * level
    images = [image.clamp(0, 1) for image, _ in views]
    kept = slice(None) if valid is None else valid
    shown = torch.zeros(photo.shape[:2], dtype=torch.bool, device=photo.device)
    if opacity is not None:
        shown = opacity.to(photo.device) >= PHOTO_OPAQUE
    if valid is not None:
        shown &= valid
    return [
        [
            float(psnr(image[kept], photo[kept])),
            float(ssim(image, photo, valid)),
            float(psnr(image[shown], photo[shown])) if shown.any() else math.nan,
        ]
        for image in images
    ]


def _label_metrics(splats: Splats, capture: Capture, rows: Sequence[int]) -> dict[str, Any]:
    """IoU of the rendered labels of some views; empty without identities or label maps."""
    if splats.classifier is None:
        return {}
    known = torch.tensor(splats.classifier.ids)
    pairs: list[tuple[Labels, Labels]] = []
    unknown: set[int] = set()
    for row in track(rows, "comparing with label maps"):
        given = capture.labels(row)
        if given is not None:
            rendered = render_labels(splats, capture.cameras[row]).cpu()
            is_known = torch.isin(given, known.to(given))
            unknown.update(given[~is_known].unique().tolist())
            valid = capture.valid(row)
            is_known = is_known if valid is None else is_known & valid
            # What is background on either side counts for no object
            pairs.append((rendered.where(is_known, BACKGROUND), given.where(is_known, BACKGROUND)))
    if not pairs:
        return {}
    metrics: dict[str, Any] = {"unknown_ids": sorted(unknown)} if unknown else {}
    for prefix, boundary in (("", False), ("boundary_", True)):
        by_id = object_iou(pairs, boundary=boundary)
        metrics[f"{prefix}iou"] = by_id
        metrics[f"{prefix}miou"] = sum(by_id.values()) / max(len(by_id), 1)
    return metrics


@torch.no_grad()
def fitted_render(
    splats: Splats,
    camera: Cameras,
    photo: Float[Tensor, "H W 3"],
    fits: Fits,
    valid: Bool[Tensor, "H W"] | None = None,
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W 1"]]:
    """Render the view of a photo over black, each half fitted on the other half of the photo.

    Of the photo all pixels count, or the valid ones. Returns the image and its coverage.
    """
    middle = camera.size[0] // 2
    left, right = slice(None, middle), slice(middle, None)
    images, alphas = [], []
    for drawn, fitted in ((left, right), (right, left)):
        counted = None if valid is None else valid[:, fitted]
        view = camera
        if fits.pose:
            view = _fit_camera(splats, camera, photo, fitted, fits, counted)
        image, alpha = render(splats, view)
        if fits.colors:
            change = fit_color_map(image[:, fitted], alpha[:, fitted], photo[:, fitted], counted)
            image = apply_color_map(image, alpha, change)
        images.append(image[:, drawn])
        alphas.append(alpha[:, drawn])
    return torch.cat(images, dim=1), torch.cat(alphas, dim=1)


def _fit_camera(
    splats: Splats, camera: Cameras, photo: Tensor, columns: slice, fits: Fits, valid: Tensor | None
) -> Cameras:
    """Shift a camera so that the render of some columns matches its photo."""
    target = photo[:, columns]
    part = camera.crop((columns.start or 0, 0), (target.shape[1], target.shape[0]))
    shift = photo.new_zeros(1, 6).requires_grad_()
    params = {"pose_shifts": shift}
    moments = Moments.zeros(params)
    for step in range(PHOTO_STEPS):
        shift.grad = None
        with torch.enable_grad():
            images, alphas, _ = rasterize(splats, shift_cameras(part, shift, fits.unit))
            image, alpha = images[0], alphas[0]
            if fits.colors:
                change = fit_color_map(image.detach(), alpha.detach(), target, valid)
                image = apply_color_map(image, alpha, change)
            photometric_loss(image, blown_out_target(image, target), valid)[0].backward()
        rate = FIRST_RATE * (LAST_RATE / FIRST_RATE) ** (step / (PHOTO_STEPS - 1))
        adam_step(params, moments, {"pose_shifts": rate}, step + 1)
    return shift_cameras(camera, shift.detach(), fits.unit)

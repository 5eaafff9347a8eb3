"""How close renders are to the photos, and rendered labels to the given ones."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.half_fits import Fits, fitted_render
from stylesplat.metrics.iou import object_iou
from stylesplat.metrics.psnr import psnr
from stylesplat.metrics.ssim import ssim
from stylesplat.progress import track
from stylesplat.rendering.render import render
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, Labels
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import render_labels

NO_FITS = Fits()
MEASURED = 8  # views of an import


def measured_rows(capture: Capture) -> list[int]:
    """The views of an import that are compared with their photos: none of them is held out."""
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
        rows: Which views to compare; the held-out ones, usually.
        fits: What each photo has of its own, as in the training that made the splats: for its
            left half that is fitted on the right one, and the other way round.

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
    return metrics | _label_metrics(splats, capture, rows)


def _closeness(image: Float[Tensor, "H W 3"], photo: Float[Tensor, "H W 3"]) -> Float[Tensor, "2"]:
    return torch.stack([psnr(image, photo), ssim(image, photo)])


def _label_metrics(splats: Splats, capture: Capture, rows: Sequence[int]) -> dict[str, Any]:
    if splats.classifier is None:
        return {}
    known = torch.tensor(splats.classifier.ids)
    pairs: list[tuple[Labels, Labels]] = []
    unknown: set[int] = set()
    for row in rows:
        given = capture.labels(row)
        if given is not None:
            rendered = render_labels(splats, capture.cameras[row]).cpu()
            seen = torch.isin(given, known.to(given))
            unknown.update(given[~seen].unique().tolist())
            # What is background on either side counts for no object
            pairs.append((rendered.where(seen, BACKGROUND), given.where(seen, BACKGROUND)))
    if not pairs:
        return {}
    metrics: dict[str, Any] = {"unknown_ids": sorted(unknown)} if unknown else {}
    for prefix, boundary in (("", False), ("boundary_", True)):
        by_id = object_iou(pairs, boundary=boundary)
        metrics[f"{prefix}iou"] = by_id
        metrics[f"{prefix}miou"] = sum(by_id.values()) / max(len(by_id), 1)
    return metrics

"""How close renders are to the photos, and rendered labels to the given ones."""

from collections.abc import Iterable, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor
from tqdm import tqdm

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import BACKGROUND, render_labels
from stylesplat.training.ssim import ssim


def psnr(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Peak signal-to-noise ratio in decibels of images in 0..1; infinite if they are equal."""
    return -10 * (image - target).square().mean().log10()


def mean_iou(pairs: Iterable[tuple[Int[Tensor, "H W"], Int[Tensor, "H W"]]]) -> float:
    """Intersection over union of predicted and given label maps, averaged over the objects.

    Args:
        pairs: Predicted and given label map of each view. Pixels are pooled over the views.

    Returns:
        The mean over all ids that occur on either side, background left out; NaN if none does.
    """
    intersections: dict[int, int] = {}
    unions: dict[int, int] = {}
    for predicted, given in pairs:
        ids = {*predicted.unique().tolist(), *given.unique().tolist()} - {BACKGROUND}
        for id in ids:
            here, there = predicted == id, given == id
            intersections[id] = intersections.get(id, 0) + int((here & there).sum())
            unions[id] = unions.get(id, 0) + int((here | there).sum())
    ratios = [intersections[id] / unions[id] for id in unions]
    return sum(ratios) / len(ratios) if ratios else float("nan")


@torch.no_grad()
def evaluate_views(
    splats: Splats, capture: Capture, rows: Sequence[int], *, backend: Backend = "auto"
) -> dict[str, float]:
    """Compare renders with photos.

    Args:
        splats: The Gaussians.
        capture: Photos and their cameras.
        rows: Which views to compare; the held-out ones, usually.
        backend: See `rasterize`.

    Returns:
        `psnr` and `ssim`, averaged over the views, and `miou` if the splats have identities and
        these views have label maps.

    Raises:
        StyleSplatError: If `rows` is empty.
    """
    if not rows:
        raise StyleSplatError(
            "There are no held-out views to evaluate. Train with `--test-every 8`."
        )
    scores = []
    for row in tqdm(rows, desc="evaluate", unit="view"):
        image, _, _ = rasterize(splats, capture.cameras[row], backend=backend)
        photo = capture.photos[row].to(image) / 255
        image = image[0].clamp(0, 1)
        scores.append(torch.stack([psnr(image, photo), ssim(image, photo)]))
    means = torch.stack(scores).mean(dim=0)
    metrics = {"psnr": means[0].item(), "ssim": means[1].item()}
    pairs = list(_label_pairs(splats, capture, rows, backend))
    return metrics | ({"miou": mean_iou(pairs)} if pairs else {})


def _label_pairs(
    splats: Splats, capture: Capture, rows: Sequence[int], backend: Backend
) -> Iterable[tuple[Tensor, Tensor]]:
    if splats.classifier is None or capture.label_maps is None:
        return
    for row in rows:
        given = capture.label_maps[row]
        if given is not None:
            yield render_labels(splats, capture.cameras[row], backend=backend).cpu(), given

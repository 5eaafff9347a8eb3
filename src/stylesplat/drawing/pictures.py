"""Pictures of splats: colour, labels, identities, depth, or one object alone."""

from collections.abc import Callable, Iterator

import cv2
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import expected_depth
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import render_labels, require_identities

Painter = Callable[[Cameras], UInt8[Tensor, "H W 3"] | Int[Tensor, "H W"]]

WHITE = (1.0, 1.0, 1.0)
PERCENTILES = (0.02, 0.98)  # what is spread over the whole range of colours; the rest clips
MAX_SAMPLE = 100_000  # Gaussians that ranges are measured on; torch.quantile sorts them all
TINY = 1e-6  # keeps 0 / 0 at 0: identities that are all the same
HUE_STEP, VALUE_STEP = 0.6180339887, 0.7548776662  # irrational, so that ids near by differ


def render_pictures(
    splats: Splats,
    cameras: Cameras,
    what: str = "color",
    *,
    picked: Bool[Tensor, " N"] | None = None,
) -> Iterator[UInt8[Tensor, "H W 3"] | Int[Tensor, "H W"]]:
    """Render one picture per camera; colours mean the same in all of them.

    Args:
        splats: The Gaussians.
        cameras: The views; sizes may differ.
        what: `color`; `labels`, the label ids themselves; `identities`, their first three
            principal components (the paper's Figure 3); `depth`, near is bright; or `object`,
            some Gaussians alone on white.
        picked: Which these are.

    Yields:
        An image, or for `labels` a label map, on the CPU.

    Raises:
        StyleSplatError: If `what` is unknown, or needs identities that are not there.
    """
    paint = _painter(splats.detach(), cameras, what, picked)
    return (paint(cameras[row]).cpu() for row in range(len(cameras)))


def label_colors(labels: Int[Tensor, "H W"]) -> UInt8[Tensor, "H W 3"]:
    """A label map in colours to look at: a fixed, distinct one per id, background black."""
    ids = labels.double()
    hue, value = ids * HUE_STEP, 0.5 + 0.5 * (ids * VALUE_STEP % 1)
    channels = torch.stack([hue, hue + 2 / 3, hue + 1 / 3], dim=-1)  # [H, W, 3]
    rgb = value[..., None] * ((6 * (channels % 1) - 3).abs() - 1).clamp(0.2, 1)
    return to_uint8(torch.where(labels[..., None] == 0, 0, rgb))


def _painter(
    splats: Splats, cameras: Cameras, what: str, picked: Bool[Tensor, " N"] | None
) -> Painter:
    if what == "color":
        return lambda camera: _paint_color(splats, camera, None)
    if what == "labels":
        require_identities(splats)
        return lambda camera: render_labels(splats, camera)
    if what == "identities":
        colors = identity_colors(splats)
        return lambda camera: to_uint8(_composite(splats, camera, colors))
    if what == "depth":
        near_far = depth_range(splats, cameras)
        return lambda camera: _paint_depth(splats, camera, near_far)
    if what == "object" and picked is not None:
        alone = splats[picked.to(splats.device)]
        return lambda camera: _paint_color(alone, camera, WHITE)
    raise StyleSplatError(
        f"Cannot render {what!r}. Choose color, labels, identities, depth or object:NAME."
    )


def identity_colors(splats: Splats) -> Float[Tensor, "N 3"]:
    """The first three principal components of the identities, spread over 0..1.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    identities, _ = require_identities(splats)
    centred = identities - identities.mean(dim=0)
    _, axes = torch.linalg.eigh(centred.T @ centred)  # ascending
    components = centred @ axes[:, -3:].flip(-1)
    low, high = _robust_range(components)
    return ((components - low) / (high - low).clamp(min=TINY)).clamp(0, 1)


def depth_range(splats: Splats, cameras: Cameras) -> tuple[float, float]:
    """Depths between which nearly all Gaussians lie, seen from these cameras."""
    means = _sample(splats.means)
    viewmats = cameras.viewmats.to(means)
    depths = torch.einsum("cj,nj->cn", viewmats[:, 2, :3], means) + viewmats[:, 2, 3:]
    depths = depths.flatten()
    low, high = _robust_range(depths[depths > 0][:, None])
    return low.item(), high.item()


def _paint_color(
    splats: Splats, camera: Cameras, background: tuple[float, ...] | None
) -> UInt8[Tensor, "H W 3"]:
    behind = None if background is None else splats.means.new_tensor(background)
    image, _, _ = rasterize(splats, camera, background=behind)
    return to_uint8(image[0])


def _composite(
    splats: Splats, camera: Cameras, colors: Float[Tensor, "N 3"]
) -> Float[Tensor, "H W 3"]:
    """Composite other colours than the splats' own, over white."""
    image, alphas, _ = rasterize(splats, camera, features=colors, sh_degree=0)
    return image[0, ..., 3:] + (1 - alphas[0])


def _paint_depth(
    splats: Splats, camera: Cameras, near_far: tuple[float, float]
) -> UInt8[Tensor, "H W 3"]:
    depths, alphas = expected_depth(splats, camera)
    depth, alpha = depths[..., None], alphas[..., None]
    near, far = near_far
    nearness = (1 / depth.clamp(min=near) - 1 / far) / (1 / near - 1 / far)
    values = to_uint8(nearness)[..., 0].cpu().numpy()
    bgr = torch.from_numpy(cv2.applyColorMap(values, cv2.COLORMAP_VIRIDIS)).to(alpha.device)
    return to_uint8(bgr.flip(-1) / 255 * alpha + (1 - alpha))


def _robust_range(
    values: Float[Tensor, "M D"],
) -> tuple[Float[Tensor, " D"], Float[Tensor, " D"]]:
    levels = values.new_tensor(PERCENTILES)
    low, high = torch.quantile(_sample(values), levels, dim=0)
    return low, high


def _sample(values: Float[Tensor, "M D"]) -> Float[Tensor, "_ D"]:
    return values[:: max(1, len(values) // MAX_SAMPLE)]


def to_uint8(image: Float[Tensor, "H W D"]) -> UInt8[Tensor, "H W D"]:
    """An image in 0..1 as bytes; what is out of range is clamped."""
    return (image.clamp(0, 1) * 255).round().to(torch.uint8)

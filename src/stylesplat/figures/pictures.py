"""Pictures of splats: colour, labels, identities, depth, or one object alone."""

import re
from collections.abc import Callable, Iterator

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.images import ColorPicture, ViewPicture
from stylesplat.rendering.render import render
from stylesplat.rendering.view_pool import map_views
from stylesplat.rendering.weights import COVERED, expected_depth
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import render_labels, require_identities

Background = tuple[float, float, float] | None
"""A colour in 0..1, or None where the picture is to be transparent."""

BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
TRANSPARENT = "transparent"
PICTURE_NAMED: dict[str, Background] = {TRANSPARENT: None, "black": BLACK, "white": WHITE}
HEX = re.compile("#?([0-9a-f]{6})")
# By default black is behind colours and white behind these; ids and distances have no background
PICTURE_BEHIND: dict[str, Background] = {
    "color": BLACK,
    **dict.fromkeys(("identities", "depth", "object"), WHITE),
}
PERCENTILES = (0.02, 0.98)  # are the ends of the range of colours; values beyond are clamped
MAX_SAMPLE = 100_000  # Gaussians that ranges are measured on; torch.quantile sorts them all
PICTURE_TINY = 1e-6  # keeps 0 / 0 at 0: identities that are all the same
# Coefficients of red, green and blue in nearness to the powers 0 to 7: matplotlib's viridis, to 2.5
# levels of 255
VIRIDIS = (
    *((0.257, 0.004, 0.323), (1.149, 1.498, 1.954), (-14.629, -1.202, -7.728)),
    *((75.573, 2.29, 24.515), (-215.529, -8.278, -64.381), (325.263, 18.801, 109.509)),
    *((-237.507, -18.968, -100.261), (66.418, 6.761, 36.206)),
)
HUE_STEP, VALUE_STEP = 0.6180339887, 0.7548776662  # irrational, so that ids near by differ


def parse_background(text: str) -> Background:
    """The colour that a name or `#rrggbb` stands for.

    Example:
        >>> parse_background("#ff0033")
        (1.0, 0.0, 0.2)
    """
    if text.lower() in PICTURE_NAMED:
        return PICTURE_NAMED[text.lower()]
    match = HEX.fullmatch(text.lower())
    if not match:
        raise StyleSplatError(
            f"There is no background {shorten(text)!r}. Use {', '.join(PICTURE_NAMED)}, or a "
            "colour as #rrggbb."
        )
    red, green, blue = (byte / 255 for byte in bytes.fromhex(match[1]))
    return red, green, blue


def _on_background(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], background: Background
) -> ColorPicture:
    """A picture on a background; without one, its own colours and how opaque it is."""
    if background is not None:
        return to_uint8(image + (1 - alpha) * image.new_tensor(background))
    shown = to_uint8(alpha)
    # By the alpha that is written: so that on black it is the render again
    colors = torch.where(shown > 0, image / (shown / 255).clamp(min=1 / 255), 0)
    return torch.cat([to_uint8(colors), shown], dim=-1)


def to_uint8(image: Float[Tensor, "H W D"]) -> UInt8[Tensor, "H W D"]:
    """An image in 0..1 as bytes; what is out of range is clamped."""
    return (image.clamp(0, 1) * 255).round().to(torch.uint8)


def render_pictures(
    splats: Splats,
    cameras: Cameras,
    what: str = "color",
    *,
    picked: Bool[Tensor, " N"] | None = None,
    background: str | None = None,
) -> Iterator[ViewPicture]:
    """Render one picture per camera, on the CPU; colours mean the same in all of them.

    For `what` and `background` see `verbs.render.render`; `object` draws the picked Gaussians
    alone. Sizes of cameras may differ.
    """
    behind = PICTURE_BEHIND.get(what)
    if background is not None:
        if what not in PICTURE_BEHIND:
            raise StyleSplatError(f"{what} has no background. Leave --background out.")
        behind = parse_background(background)
    draw = _renderer(splats.detach(), cameras, what, picked, behind)
    return map_views(lambda row: draw(cameras[row]).cpu(), range(len(cameras)), splats.device)


def render_picture(splats: Splats, camera: Cameras, background: str | None = None) -> ColorPicture:
    """The picture of `render_pictures` that one camera sees."""
    return next(iter(render_pictures(splats, camera, background=background)))


def label_colors(labels: Int[Tensor, "H W"]) -> UInt8[Tensor, "H W 3"]:
    """A label map in colours to look at: a fixed, distinct one per id, background black."""
    ids = labels.double()
    hue, value = ids * HUE_STEP, 0.5 + 0.5 * (ids * VALUE_STEP % 1)
    channels = torch.stack([hue, hue + 2 / 3, hue + 1 / 3], dim=-1)  # [H, W, 3]
    rgb = value[..., None] * ((6 * (channels % 1) - 3).abs() - 1).clamp(0.2, 1)
    return to_uint8(torch.where(labels[..., None] == 0, 0, rgb))


def _renderer(
    splats: Splats,
    cameras: Cameras,
    what: str,
    picked: Bool[Tensor, " N"] | None,
    behind: Background,
) -> Callable[[Cameras], ViewPicture]:
    if what == "color":
        return lambda camera: _on_background(*render(splats, camera), behind)
    if what == "object" and picked is not None:
        alone = splats[picked.to(splats.device)]
        return lambda camera: _on_background(*render(alone, camera), behind)
    if what == "labels":
        require_identities(splats)
        return lambda camera: render_labels(splats, camera)
    if what == "label-colors":
        require_identities(splats)
        return lambda camera: label_colors(render_labels(splats, camera))
    if what == "identities":
        colors = identity_colors(splats)

        def identities(camera: Cameras) -> ColorPicture:
            image, alphas = render(splats, camera, features=colors, sh_degree=0)
            return _on_background(image[..., 3:], alphas, behind)

        return identities
    if what == "depth":
        low, high = _robust_range(_depths_in_front(splats, cameras)[:, None])
        return lambda camera: _depth_picture(splats, camera, low.item(), high.item(), behind)
    if what == "depth-float":
        return lambda camera: _depth_map(splats, camera)
    raise StyleSplatError(
        f"Cannot render {what!r}. Choose color, labels, label-colors, identities, depth, "
        "depth-float or object:NAME."
    )


def identity_colors(splats: Splats) -> Float[Tensor, "N 3"]:
    """The first three principal components of the identities, spread over 0..1."""
    identities, _ = require_identities(splats)
    centred = identities - identities.mean(dim=0)
    _, axes = torch.linalg.eigh(centred.T @ centred)  # ascending
    axes = axes[:, -3:].flip(-1)
    axes = axes * axes.sum(dim=0).sign()  # each solver has signs of its own
    components = centred @ axes
    low, high = _robust_range(components)
    return ((components - low) / (high - low).clamp(min=PICTURE_TINY)).clamp(0, 1)


def _depth_map(splats: Splats, camera: Cameras) -> Float[Tensor, "H W"]:
    """Depths along the view, in world units; 0 where less than half of a pixel is covered."""
    depths, alphas = expected_depth(splats, camera)
    return torch.where(alphas < COVERED, 0, depths)


def _depths_in_front(splats: Splats, cameras: Cameras) -> Float[Tensor, " M"]:
    means = _sample(splats.means)
    viewmats = cameras.viewmats.to(means)
    depths = torch.einsum("cj,nj->cn", viewmats[:, 2, :3], means) + viewmats[:, 2, 3:]
    depths = depths[depths > 0]
    if not len(depths):
        raise StyleSplatError("No Gaussian lies in front of these views. Choose other views.")
    return _sample(depths[:, None])[:, 0]


def _depth_picture(
    splats: Splats, camera: Cameras, near: float, far: float, behind: Background
) -> ColorPicture:
    """Depths in colours, near ones bright."""
    depths, alphas = expected_depth(splats, camera)
    nearness = (1 / depths.clamp(min=near) - 1 / far) / (1 / near - 1 / far)
    powers = nearness.clamp(0, 1)[..., None] ** torch.arange(len(VIRIDIS)).to(nearness)
    colors = (powers @ powers.new_tensor(VIRIDIS)).clamp(0, 1)
    alpha = alphas[..., None]
    return _on_background(colors * alpha, alpha, behind)


def _robust_range(values: Float[Tensor, "M D"]) -> tuple[Float[Tensor, " D"], Float[Tensor, " D"]]:
    levels = values.new_tensor(PERCENTILES)
    low, high = torch.quantile(_sample(values), levels, dim=0)
    return low, high


def _sample(values: Float[Tensor, "M D"]) -> Float[Tensor, "_ D"]:
    return values[:: max(1, len(values) // MAX_SAMPLE)]

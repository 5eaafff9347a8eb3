"""How close painted objects are to their styles: NNFM, colours, content."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.changes import measure_changes, view_consistency
from stylesplat.imaging.color import cells, distinct, lab_from_rgb, nearest_colors, thinned
from stylesplat.imaging.similarity import ssim_map
from stylesplat.progress import say
from stylesplat.rendering.render import render
from stylesplat.rendering.weights import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import LUMA, Splats
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.matching import nnfm_loss
from stylesplat.stylization.optimize import target_features
from stylesplat.stylization.painting import Painting, PaintSetup
from stylesplat.stylization.style import all_colors, fit_style, style_features
from stylesplat.stylization.views import (
    ObjectBox,
    PaintView,
    object_views,
    require_boxes,
    typical_length,
)

MAX_FEATURES = 8192  # of an object in a view that are measured: block 1 has one per pixel
LOOK_PLACES = 2048  # features of all pictures that are compared with the others
LOOK_AT_ONCE = 256  # of them, as block 1 has a feature per pixel
NOWHERE = -2.0  # below any cosine
# Pixels; the size of objects at which features are compared, whatever `scale` is
LOOK_LENGTH = 192.0
LOOK_VIEWS = 4  # of the object, and of the scene
LOOK_BARE = 0.5 / 255  # of a colour: a pixel that changes less looks as before
LOOK_TOLERANCE = 10.0  # of Lab, from which a colour is another one, rather than another shade
LOOK_SAME = 1.0  # of Lab, the size of the cubes whose colours count as one
SURELY_NEAR = 5.0  # of Lab: no colours in a cube of this size are farther apart than 8.7


def measure_painted(
    objects: Sequence[tuple[PaintSetup, Painting]],
    styled: Splats,
    surveys: Mapping[str, Sequence[ObjectBox]],
) -> dict[str, Any]:
    """Measure how painting some objects changed them and the rest of a scene.

    Views are the held-out ones, if there are any.

    The objects are given in the scene before, whose Gaussians come first in `styled`. By name
    `surveys` are their boxes in all views. Returns the result of `measure_changes`, and for each
    number of `measure_style` a dict by object, without those whose style is too small to be
    compared.
    """
    first, found = objects[0][0], dict[str, dict[str, float]]()
    base, cameras = first.splats, first.held_out or first.cameras
    styled, names = styled.to(base.device), {*cameras.names}
    for setup, painting in objects:
        survey = surveys[painting.name]
        boxes = [box for box in survey if box.camera.names[0] in names] or survey
        try:
            numbers = measure_style(setup, painting, styled, boxes=boxes)
        except StyleSplatError as error:  # the object is painted all the same
            say(f"{painting.name} is not compared with its style: {error}")
            continue
        for name, value in numbers.items():
            found.setdefault(name, {})[painting.name] = value
    picked = torch.stack([painting.mask for _, painting in objects]).any(dim=0)
    return measure_changes(base, styled, cameras, picked) | found


@torch.no_grad()
def measure_style(
    setup: PaintSetup,
    painting: Painting,
    styled: Splats,
    *,
    boxes: Sequence[ObjectBox] | None = None,
) -> dict[str, float]:
    """Measure how close an object is to its style by NNFM, in float32, in the views of `setup`.

    Returns:
        `nnfm_before` and `nnfm_after`; if the pictures are large enough, `nnfm_of_style` (see
        `own_nnfm`); if the object was farther from the style than that, `share_of_way`, the part
        of the way that it has gone, in 0..1; if the object is to have the colours of the style,
        the share of it that does not (`off_palette`); the share that looks as before (`bare`).

    Raises:
        StyleSplatError: If the object is not visible, or a picture is too small to compare.
    """
    block, network = painting.config.block, setup.network
    boxes = boxes or require_boxes(setup, painting)
    zoom = LOOK_LENGTH / typical_length(boxes)
    views = object_views(setup, painting, evenly_spaced(boxes, LOOK_VIEWS), zoom)
    style_feats = target_features(network, painting.config, painting.images, LOOK_LENGTH)
    unpainted, images = renders(setup.splats, views), renders(styled, views)
    before, after = (
        object_nnfm(each, views, style_feats, network, block) for each in (unpainted, images)
    )
    numbers = {"nnfm_before": before, "nnfm_after": after}
    pairs = zip(images, unpainted, views, strict=True)
    changes = [(image - was).abs().amax(dim=2)[view.pixels] for image, was, view in pairs]
    numbers["bare"] = float((torch.cat(changes) < LOOK_BARE).float().mean())
    own = own_nnfm(painting.images, network, block, length=painting.config.scale * LOOK_LENGTH)
    if own is not None:
        numbers["nnfm_of_style"] = own
        if before > own:
            numbers["share_of_way"] = min(1.0, max(0.0, (before - after) / (before - own)))
    if painting.config.color == "style":
        colors = [image[view.pixels] for image, view in zip(images, views, strict=True)]
        numbers["off_palette"] = off_palette(torch.cat(colors), all_colors(painting.images))
    return numbers


@torch.no_grad()
def measure_look(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
    *,
    boxes: Sequence[ObjectBox] | None = None,
) -> dict[str, float]:
    """Measure how much of an object's content is left, and how consistent its views are.

    Returns:
        `content_ssim`, if a view shows the object, and the result of `view_consistency`.
    """
    few = cameras[evenly_spaced(range(len(cameras)), LOOK_VIEWS)]
    similarity = content_ssim(base, styled, few, picked)
    numbers = {} if similarity is None else {"content_ssim": similarity}
    return numbers | view_consistency(base, styled, cameras, picked, boxes=boxes)


@torch.no_grad()
def content_ssim(
    base: Splats, styled: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]
) -> float | None:
    """SSIM of an object's luminance before and after, over its pixels; None if no view shows it."""
    scores = []
    for index in range(len(cameras)):
        before, coverage = colors_and_coverage(base, cameras[index], picked)
        covered = coverage[..., 0] > COVERED
        if covered.any():
            after = render(styled, cameras[index])[0]
            luminances = [(i.clamp(0, 1) @ i.new_tensor(LUMA))[None] for i in (before, after)]
            scores.append(ssim_map(*luminances)[0][covered].mean())
    return float(torch.stack(scores).mean()) if scores else None


def off_palette(colors: Float[Tensor, "P 3"], style: Float[Tensor, "Q 3"]) -> float:
    """The share of colours that are farther than 10 in Lab (CIE 1976) from all of the style.

    All are in 0..1. A large set is sampled evenly; colours of the style that differ by less than
    about 1 count as one.
    """
    lab = lab_from_rgb(thinned(colors))
    palette = lab_from_rgb(distinct(style, LOOK_SAME))
    far = ~torch.isin(cells(lab, SURELY_NEAR), cells(palette, SURELY_NEAR))
    if not far.any():
        return 0.0
    others = lab[far]
    distances = (others - palette[nearest_colors(others, palette)]).norm(dim=1)
    return int((distances > LOOK_TOLERANCE).sum()) / len(lab)


def renders(splats: Splats, views: Sequence[PaintView]) -> list[Float[Tensor, "_ _ 3"]]:
    return [render(splats, view.camera)[0].clamp(0, 1) for view in views]


def object_nnfm(
    images: Sequence[Float[Tensor, "_ _ 3"]],
    views: Sequence[PaintView],
    style_feats: Float[Tensor, "Q D"],
    network: FeatureNetwork,
    block: int,
) -> float:
    """Compute NNFM over the features of an object, averaged over views."""
    losses = []
    for image, view in zip(images, views, strict=True):
        feats = network(image, [block])[0][view.cells]
        losses.append(nnfm_loss(feats[:: 1 + len(feats) // MAX_FEATURES], style_feats))
    return float(torch.stack(losses).mean())


@torch.no_grad()
def own_nnfm(
    pictures: Sequence[Float[Tensor, "_ _ 3"]],
    network: FeatureNetwork,
    block: int,
    *,
    length: float,
) -> float | None:
    """Compute NNFM between parts of a style and the rest of it.

    Each feature is compared with those whose receptive fields do not overlap its own. Another
    picture by the same artist would hardly come closer, so an object can reach this, not 0.
    Returns the mean cosine distance; None if the pictures are too small for two such features.
    """
    cells = network.cells(block)
    features, places = [], []
    for number, picture in enumerate(pictures):
        rows = style_features(picture, network, block, length=length)
        features.append(F.normalize(rows.float(), dim=1))
        sides = fit_style(picture, network, block, length).shape[:2]
        y, x = (torch.arange(side)[cells.inside(side)] for side in sides)
        grid = torch.cartesian_prod(y, x).float().to(picture.device)
        places.append(F.pad(grid, (1, 0), value=number * 1e6))  # pictures are far apart
    found, at = torch.cat(features), torch.cat(places)
    closest = []
    for some in torch.arange(0, len(found), 1 + len(found) // LOOK_PLACES).split(LOOK_AT_ONCE):
        gaps = (at[some, None] - at[None]).abs().amax(dim=-1)
        apart = gaps * cells.stride >= cells.size
        closest.append((found[some] @ found.T).where(apart, NOWHERE).amax(dim=1))
    cosines = torch.cat(closest)
    cosines = cosines[cosines > NOWHERE]
    return float(1 - cosines.mean()) if len(cosines) else None

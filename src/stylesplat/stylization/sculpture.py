"""Sculpture: paint that stands out as the object does, for a form above 1.

Relief adds the object's light to paint. Where the form is strong, strokes of the same size hide it,
and in the darkest and brightest places there is no room for it. Sculpture takes these strokes away
and makes this room.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.imaging.color import luma_weights
from stylesplat.imaging.similarity import smooth
from stylesplat.progress import say
from stylesplat.rendering.render import render
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import COVERED, Contributions, contributions
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import RELIEF_FORM, Layer
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.colors import PAINT_HIDDEN, PAINT_STRIDE
from stylesplat.stylization.form import FORM_FAINT, form_detail, survey_detail
from stylesplat.stylization.views import ObjectBox, box_cameras, find_boxes

SCULPTURE_VIEWS, SCULPTURE_LENGTH = 16, 480.0  # 8 of 240 pixels lose letters and strings
SCULPTURE_ROUNDS = 6  # 4 are too few
GAIN = 1.5  # of the form's contrast
STROKES_LOST, STRONG = 0.4, 0.1  # share of strokes that gives way, and the contrast where half does
# Deviations of the form that fit between the mean and the paint's darkest and brightest tones
TONE_ROOM = 1.2
BEYOND = 0.25  # slope of tones beyond these
RELIEF_SHOWS = 0.01  # share of a layer's Gaussians with visible relief from which it shows any
TONES = 0.02, 0.98  # quantiles of the paint's luminance that are its darkest and brightest
# Deviations of windows, in lengths: of means, of strokes and form
SCULPTURE_MEAN, SCULPTURE_NEAR = 0.03, 0.015


def with_sculptures(scene: Scene, asked: Collection[str] = ()) -> Scene:
    """The scene with the sculpture of each layer whose form asks for it and that has none.

    `asked` names the layers whose form the user sets: of these it says where that changes nothing.
    """
    for layer in scene.layers:
        if layer.color_map is not None:
            continue
        if layer.form > RELIEF_FORM and layer.sculpture is None:
            scene = scene.with_layer(sculpted(scene.below(layer.name), layer))
        if layer.form < RELIEF_FORM and layer.name in asked and not _shows_relief(layer):
            say(
                f"{layer.name} has no detail that stands out from the rest: a form below 1 changes "
                "nothing. Above 1 its pattern comes back."
            )
    return scene


def _shows_relief(layer: Layer) -> bool:
    return bool((layer.relief.abs() > FORM_FAINT).float().mean() >= RELIEF_SHOWS)


def sculpted(below: Scene, layer: Layer) -> Layer:
    """A layer of paint with its sculpture, on what lies below it."""
    own = layer.covered(len(below.base))[below.parents]
    boxes = find_boxes(below.splats, below.cameras, own)
    if not boxes:
        return replace(layer, sculpture=torch.zeros_like(layer.relief))
    plain = replace(layer, strength=1.0, form=RELIEF_FORM, sculpture=None, visible=True, mask=None)
    painted = below.with_layers([*below.layers, plain]).splats
    covered, new = own.nonzero()[:, 0], torch.arange(len(below.splats), len(painted))
    added = sculpt(below.splats, own, painted, torch.cat([covered, new]), boxes)
    # what belongs to one row of the base changes alike
    entry = layer.rows.new_zeros(len(below.base))
    entry[layer.rows] = torch.arange(len(layer.rows))
    places = entry[below.parents[covered]]
    of_covered, of_new = added.split([len(covered), len(new)])
    of_rows = added.new_zeros(len(layer.rows))
    of_rows.scatter_reduce_(0, places, of_covered, "mean", include_self=False)
    return replace(layer, sculpture=torch.cat([of_rows, of_new]))


class _Target(NamedTuple):
    linear: Contributions
    own: Float[Tensor, "H W 1"]
    """1 where the object is."""
    missing: Float[Tensor, "H W 1"]
    """The luminance to add."""


@torch.no_grad()
def sculpt(
    before: Splats,
    own: Bool[Tensor, " B"],
    painted: Splats,
    rows: Int[Tensor, " P"],
    boxes: Sequence[ObjectBox],
) -> Float[Tensor, " P"]:
    """The luminance that each painted Gaussian adds for a form of 1.5, in -1..1.

    In views its sum with the paint has the form of the unpainted object, `GAIN` times, and fewer
    strokes where that is strong (simultaneous algebraic reconstruction, Gilbert 1972).

    Args:
        before: The scene without the paint.
        own: The object's Gaussians there.
        painted: The scene with the paint, in which form is shown in full.
        rows: The Gaussians that carry the paint.
        boxes: Where views show the object.
    """
    detail = survey_detail(before, own, boxes).as_parts()
    cameras = box_cameras(boxes, SCULPTURE_LENGTH, SCULPTURE_VIEWS)
    mask = torch.zeros_like(painted.opacities, dtype=torch.bool).index_fill_(0, rows, True)

    def look(camera: Cameras) -> tuple[Contributions, Tensor, Tensor, Tensor]:
        linear = contributions(painted, camera, mask)
        pixels = linear.coverage > COVERED
        bands = form_detail(before, camera, pixels, SCULPTURE_LENGTH, detail)
        form = torch.stack(bands).sum(dim=0)
        luma = render(painted, camera)[0] @ luma_weights(form.device, form.dtype)
        return linear, pixels, GAIN * form, luma

    looks = [*per_view(look, cameras, "looking at the form", before.device)]
    tones = torch.cat([luma[pixels] for _, pixels, _, luma in looks])
    low, high = (float(tones.quantile(q)) for q in TONES) if len(tones) else (0.0, 1.0)
    targets = [
        _Target(
            linear,
            pixels[..., None].to(luma),
            (_sculpted(luma, form, pixels, (low, high)) - luma)[..., None],
        )
        for linear, pixels, form, luma in looks
    ]
    return _solve(targets, len(painted))[rows]


def _sculpted(
    luma: Float[Tensor, "H W"],
    form: Float[Tensor, "H W"],
    mask: Bool[Tensor, "H W"],
    tones: tuple[float, float],
) -> Float[Tensor, "H W"]:
    """The luminance of a view of paint with more form and fewer strokes in its place."""
    mean, near = SCULPTURE_MEAN * SCULPTURE_LENGTH, SCULPTURE_NEAR * SCULPTURE_LENGTH
    form = form - smooth(form, mask, mean)
    around, spread = smooth(torch.stack([luma, form.square()]), mask, mean)
    room, (low, high) = TONE_ROOM * spread.sqrt(), tones
    middle = torch.full_like(luma, (low + high) / 2)
    lifted = around.maximum((low + room).minimum(middle)).minimum((high - room).maximum(middle))
    detail = luma - around
    energy, shared = smooth(torch.stack([form.square(), detail * form]), mask, near)
    share = shared / energy.clamp(min=1e-6)  # of the form that the paint shows
    strokes = detail - share * form
    kept = 1 - STROKES_LOST * energy / (energy + STRONG**2)
    wanted = lifted + share.clamp(min=1) * form + kept * strokes
    inside = wanted.clamp(low, high)
    return (inside + BEYOND * (wanted - inside)).where(mask, luma)


def _solve(targets: Sequence[_Target], count: int) -> Float[Tensor, " N"]:
    """The luminance of each Gaussian whose renders are nearest to what is missing in all views."""
    added, weights = (targets[0].missing.new_zeros(count, 1) for _ in range(2))
    for linear, own, _ in targets:
        weights.index_add_(0, linear.gaussians, linear.backproject(own))
    for _ in range(SCULPTURE_ROUNDS):
        change = torch.zeros_like(added)
        for linear, own, missing in targets:
            error = (missing - linear.composite(added[linear.gaussians])) * own
            change.index_add_(0, linear.gaussians, linear.backproject(error))
        added += PAINT_STRIDE * change / weights.clamp(min=PAINT_HIDDEN)
        added = torch.where(weights > PAINT_HIDDEN, added, 0).clamp(-1, 1)
    return added[:, 0]

"""A canvas: small, evenly spread discs on an object's surface, which carry the strokes.

The pattern of an object is in the shapes of its Gaussians, too: it shows whatever colours they
take. The canvas hides them. They keep their positions, and undoing gives them back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.progress import track
from stylesplat.rendering.reference import rotation_matrices, with_matrices_of
from stylesplat.rendering.render import colors_of, rasterize
from stylesplat.rendering.surface import (
    average_in_voxels,
    find_surface,
    poisson_disk_sample,
    project_to_planes,
)
from stylesplat.rendering.view_pool import map_views, per_view
from stylesplat.rendering.visibility import in_view
from stylesplat.rendering.weights import (
    COVERED,
    Contributions,
    contributions,
    coverage,
    geometry_only,
    pixels_in,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Layer, Source, appearance_only, split_name
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.sequences import shuffled_repeats
from stylesplat.scene.splats import SH_C0, Splats, sh0_from_rgb
from stylesplat.stylization.config import Precision, plain_settings
from stylesplat.stylization.painting import Painting, with_relief_form
from stylesplat.stylization.style import digest
from stylesplat.stylization.views import ObjectBox, Surface, box_cameras
from stylesplat.training.adam import Moments, adam_step

SPACING = 1.1  # pixels between discs: what is wider shows soft strokes, what is finer noise
DISC_WIDE, DISC_FLAT = 0.75, 0.15  # deviations of a disc in its plane and across it, in spacings
SHOWN_LEAST = 0.3  # pixels of a disc in the view that shows most of it: less is hidden by others
# Of a disc before it is fitted: more looks grainy, as a pixel shows a single disc
CANVAS_OPACITY = 0.8
# Hidden part of a Gaussian's contribution from which it fades, and is gone
CANVAS_HIDDEN = (0.5, 0.9)
CANVAS_FEW = 500  # pixels of all views that show no surface
CANVAS_SPARE = 0.95  # share of the discs' maximum that is aimed at
CUBE = 3.0  # pixels of the side of cubes that tell how many discs there will be
PER_CUBE = 0.5  # discs, one side from each other: fox has .52, doll .45, a ball .37

CANVAS_STEPS = 18  # with 28 painted objects look the same
CANVAS_RATES = {"opacities": 0.1, "scales": 0.03, "sh0": 0.05}  # of logits, logarithms and colours
RAISED = 0.4  # colours at most: more is noise, with none what lies behind shines through
CANVAS_LAST = 0.1  # rate of the last step, as a share of the first's


class UnpaintedView(NamedTuple):
    """What one camera sees of an object before a canvas is laid on it."""

    camera: Cameras
    linear: Contributions
    """The contributions of the object's Gaussians."""
    image: Float[Tensor, "H W 3"]


@dataclass(frozen=True, eq=False)
class Canvas:
    """The Gaussians that carry an object's paint: its own, and discs under which these fade."""

    before: Splats
    """The scene without discs, whose detail they blur."""
    own: Bool[Tensor, " B"]
    """The object's Gaussians there."""
    splats: Splats
    """The discs follow all other Gaussians."""
    parents: Int[Tensor, " N"]
    """The Gaussian of the scene before that each one belongs to: of a disc, the nearest."""
    views: Sequence[UnpaintedView] = ()
    """Views of the scene before, until the canvas is complete."""
    spacing: float = 0.0
    """The distance between neighbouring discs."""

    @classmethod
    def without_discs(cls, splats: Splats, own: Bool[Tensor, " N"]) -> "Canvas":
        """The object on its own Gaussians."""
        return cls(splats, own, splats, torch.arange(len(splats), device=splats.device))

    @property
    def is_disc(self) -> Bool[Tensor, " N"]:
        return torch.arange(len(self.parents), device=self.parents.device) >= len(self.own)

    @property
    def mask(self) -> Bool[Tensor, " N"]:
        """Which of its Gaussians are painted."""
        return self.own[self.parents]

    @property
    def surface(self) -> Surface | None:
        """The object's surface as the discs sample it; None without discs."""
        discs = self.splats[self.is_disc]
        return (discs.means, rotation_matrices(discs.quats)[:, :, 2]) if len(discs) else None

    def changed(self, **tensors: Tensor) -> "Canvas":
        return replace(self, splats=replace(self.splats, **tensors))

    def select(self, kept: Bool[Tensor, " N"]) -> "Canvas":
        """The canvas with some of its Gaussians, all of the scene before among them."""
        return replace(self, splats=self.splats[kept], parents=self.parents[kept])


@dataclass(frozen=True, eq=False)
class PaintState:
    """An object that is being painted."""

    step: int
    """Steps taken."""
    steps: int
    """Steps to take in all."""
    nnfm: Float[Tensor, ""]
    """The loss in the view of the last step, before it; reading it waits for the device."""
    splats: Splats
    """The scene with the paint so far, at full intensity."""
    canvas: Canvas
    """The same Gaussians without the paint."""
    relief: Float[Tensor, " N"]
    """The object's form as luminance that each Gaussian adds; see `form_relief`."""
    boxes: Sequence[ObjectBox] = ()
    """Where the object is seen, in the views to optimise on."""


@torch.no_grad()
def build_surfels(
    splats: Splats,
    mask: Bool[Tensor, " N"],
    boxes: Sequence[ObjectBox],
    *,
    length: float,
    max_discs: int,
    seed: int,
) -> Canvas | None:
    """Lay a canvas on an object of a scene, and fade the Gaussians under it.

    The discs are fine enough for views in which the object is so many pixels long. Next come
    `fit_surfels` and `trim_surfels`. Returns None if the object has no surface, as smoke has
    none.
    """
    views = unpainted_views(splats, mask, boxes)
    pictures = [(view.camera, view.image) for view in views]
    *surface, pixel = find_surface(splats, mask, pictures)
    if len(surface[0]) < CANVAS_FEW:
        return None
    cubes, _ = average_in_voxels(CUBE * pixel, surface[0])
    most = CANVAS_SPARE * max_discs
    least = CUBE * pixel * math.sqrt(PER_CUBE * len(cubes) / most)
    spacing = max(SPACING * pixel * SURFACE_LENGTH / length, least)
    while True:
        _, (points, normals, colors) = average_in_voxels(POOLED * spacing, *surface)
        rows = poisson_disk_sample(points, spacing, seed=seed)
        if len(rows) <= max_discs:
            break
        spacing *= math.sqrt(len(rows) / most)
    means, normals = project_to_planes(points, normals, rows)
    own = mask.nonzero()[:, 0]
    parents = own[nearest_points(splats.means[own], means)[1][:, 0]]
    opaque = points.new_full((len(rows),), CANVAS_OPACITY)
    discs = replace(
        discs_at(splats[parents], means, normals, spacing, opaque),
        sh0=sh0_from_rgb(colors[rows])[:, None],
        shN=splats.shN[parents] * 0,
    )
    parents = torch.cat([torch.arange(len(splats), device=splats.device), parents])
    return fade_covered(Canvas(splats, mask, Splats.cat([splats, discs]), parents, views, spacing))


def discs_at(
    own: Splats,
    means: Float[Tensor, "D 3"],
    normals: Float[Tensor, "D 3"],
    spacing: float,
    opacities: Float[Tensor, " D"],
) -> Splats:
    """Discs so far apart, each with the rest of the Gaussian that it belongs to."""
    scales = means.new_tensor([DISC_WIDE, DISC_WIDE, DISC_FLAT]).mul(spacing).log()
    return replace(
        own,
        means=means,
        quats=_facing(normals),
        scales=scales.expand(len(means), 3).clone(),
        opacities=torch.logit(opacities),
    )


def _facing(normals: Float[Tensor, "D 3"]) -> Float[Tensor, "D 4"]:
    """Rotations of the z axis to the normals."""
    x, y, z = normals.unbind(1)
    quats = torch.stack([1 + z, -y, x, torch.zeros_like(z)], dim=1)
    quats[z < -0.999] = quats.new_tensor([0.0, 1.0, 0.0, 0.0])
    return F.normalize(quats, dim=1)


SURFACE_VIEWS = 16  # with 12 places that few of them show stay bare
SURFACE_LENGTH = 200.0  # longer side of the object in them, in pixels
SURFACE_MARGIN = 8  # pixels around its box, where nothing is to show
POOLED = 0.6  # side of the cubes whose points are averaged, in distances of the samples


@torch.no_grad()
def unpainted_views(
    splats: Splats, mask: Bool[Tensor, " N"], boxes: Sequence[ObjectBox]
) -> list[UnpaintedView]:
    """Views of the whole object, `SURFACE_LENGTH` pixels long."""

    def look(camera: Cameras) -> UnpaintedView:
        camera = with_matrices_of(splats, camera)
        linear = contributions(splats, camera, mask)
        colors = colors_of(splats, linear.gaussians, camera.positions)
        return UnpaintedView(camera, linear, linear.render(colors))

    cameras = box_cameras(boxes, SURFACE_LENGTH, SURFACE_VIEWS, SURFACE_MARGIN)
    return [*per_view(look, cameras, "looking at the object", splats.device)]


@torch.no_grad()
def fade_covered(canvas: Canvas) -> Canvas:
    """Fade the object's Gaussians as far as the discs hide them."""
    before, splats, count = canvas.before, canvas.splats, len(canvas.before)
    others = ~canvas.mask | canvas.is_disc
    bare, is_disc = geometry_only(splats[others]), canvas.is_disc[others]

    def look(view: UnpaintedView) -> Tensor:
        hidden = coverage(bare, view.camera, is_disc) > COVERED
        return view.linear.pixels_in(torch.stack([hidden, torch.ones_like(hidden)], dim=-1))

    found = per_view(look, canvas.views, "looking under the canvas", splats.device)
    hidden, everywhere = torch.stack([*found]).sum(dim=0).unbind(dim=1)
    low, high = CANVAS_HIDDEN
    fading = ((hidden / everywhere.clamp(min=1e-9) - low) / (high - low)).clamp(0, 1) * canvas.own
    faded = torch.logit(torch.sigmoid(before.opacities) * (1 - fading), eps=1e-6)
    faded = torch.where(fading > 0, faded, before.opacities)
    return canvas.changed(opacities=torch.cat([faded, splats.opacities[count:]]))


@torch.no_grad()
def drop_hidden(canvas: Canvas, length: float) -> Canvas:
    """The canvas without the discs of which no view shows a pixel if the object is so long there.

    Noise of depths makes layers of discs of which only the first shows.
    """
    return canvas.select(~canvas.is_disc | (pixels_shown(canvas, length) >= SHOWN_LEAST))


def pixels_shown(canvas: Canvas, length: float) -> Float[Tensor, " N"]:
    """The pixels of each Gaussian in the view that shows most of it, with the object so long."""
    bare = geometry_only(canvas.splats)

    def look(view: UnpaintedView) -> Tensor:
        return pixels_in(bare, [view.camera], [torch.ones_like(view.linear.coverage)])

    found = per_view(look, canvas.views, "looking for hidden discs", bare.device)
    return reduce(torch.maximum, found) * (length / SURFACE_LENGTH) ** 2


class _View(NamedTuple):
    """What one camera saw before the canvas was laid, and what it sees of it."""

    before: UnpaintedView
    rows: Int[Tensor, " M"]
    """The Gaussians of the scene with the canvas that are in view."""
    splats: Splats
    """These, in the colours that they have from there."""


def fit_surfels(canvas: Canvas, *, seed: int) -> Canvas:
    """Give the discs of a canvas what makes the object look as before.

    In every step the object's colours are raised by other amounts, so that its coverage has to be
    right whatever lies behind.
    """

    def look(before: UnpaintedView) -> _View:
        splats, camera = canvas.splats, before.camera
        rows = in_view(splats, camera).rows
        colors = colors_of(splats, rows, camera.positions)
        baked = replace(geometry_only(splats)[rows], sh0=sh0_from_rgb(colors)[:, None])
        return _View(before, rows, baked)

    views = [*map_views(look, canvas.views, canvas.splats.device)]
    leaves = {name: canvas.splats.tensors()[name].clone().requires_grad_() for name in CANVAS_RATES}
    moments, own = Moments.zeros(leaves), canvas.mask.to(canvas.splats.means)
    generator = torch.Generator().manual_seed(seed)
    order = [
        (view, torch.rand(3, generator=generator))
        for view in shuffled_repeats(views, CANVAS_STEPS, generator)
    ]
    raises = (RAISED * torch.stack([raised for _, raised in order])).to(own)  # at once, to a GPU
    turns = zip((view for view, _ in order), raises, strict=True)
    for step, (view, raised) in enumerate(
        track(turns, "fitting the canvas", total=CANVAS_STEPS), start=1
    ):
        before, rows, is_disc = view.before, view.rows, canvas.is_disc[view.rows]
        with torch.enable_grad():
            moved = {name: leaf[rows] for name, leaf in leaves.items()}
            sh0 = torch.where(is_disc[:, None, None], moved["sh0"], view.splats.sh0)
            moved["sh0"] = sh0 + raised / SH_C0 * own[rows, None, None]
            image, _, _ = rasterize(replace(view.splats, **moved), before.camera)
            wanted = before.image + raised * before.linear.coverage[..., None]
            (image[0] - wanted).square().mean().backward()
        rates = {
            name: rate * CANVAS_LAST ** (step / CANVAS_STEPS) for name, rate in CANVAS_RATES.items()
        }
        visible = torch.zeros_like(canvas.is_disc).index_copy(0, rows, is_disc)
        adam_step(leaves, moments, rates, step, visible=visible)
        for leaf in leaves.values():
            leaf.grad = None
    return canvas.changed(**{name: leaf.detach() for name, leaf in leaves.items()})


LEAST_WEIGHT = 1e-6  # of an invisible Gaussian, in means


def layer_of(state: PaintState, painting: Painting, precision: Precision | None = None) -> Layer:
    """The layer of an object that is being painted, with features of this precision.

    A row of the base stands for all Gaussians below that belong to it: its paint is their mean.
    """
    count, own = len(painting.mask), painting.mask.nonzero()[:, 0]
    parents = painting.parents
    if parents is None:
        parents = torch.arange(count, device=own.device)
    before, after, canvas = state.canvas.before, state.splats.detach(), state.canvas
    weights = painting.weights
    if weights and weights.path:
        weights = Source(weights.path.resolve(), weights.sha256 or digest(weights.path))
    opacities = torch.sigmoid(before.opacities[own])
    is_fading = after.opacities[own] != before.opacities[own]
    factors = (torch.sigmoid(after.opacities[own]) / opacities).clamp(0, 1)
    rows, members = parents[own].unique(return_inverse=True)
    mean = partial(_group_means, members=members, weights=opacities.clamp(min=LEAST_WEIGHT))
    object, label = split_name(painting.name)
    return Layer(
        object=object,
        label=label,
        rows=rows,
        shares=torch.ones_like(rows, dtype=after.means.dtype),
        sh0=mean(after.sh0[own]),
        shN=mean(after.shN[own]),
        opacity_factors=mean(torch.where(is_fading, factors, torch.ones_like(factors))),
        surfels=appearance_only(after[count:]).map(torch.clone),  # without the rest's memory
        surfels_sh0=canvas.splats.sh0[count:].clone(),
        parents=parents[canvas.parents[count:]],
        relief=torch.cat([mean(state.relief[own]), state.relief[count:]]),
        strength=painting.config.intensity,
        form=painting.config.form,
        settings=plain_settings(with_relief_form(painting.config)),
        styles=painting.style.sources() if painting.style else (),
        features=painting.features,
        weights=weights,
        precision=precision,
    )


def _group_means(
    values: Float[Tensor, "O *_"], members: Int[Tensor, " O"], weights: Float[Tensor, " O"]
) -> Float[Tensor, "R *_"]:
    """The weighted means of groups of values; of a single value that value, to the bit."""
    count = int(members.max()) + 1
    shape = (-1, *(1,) * (values.dim() - 1))
    sums = values.new_zeros(count, *values.shape[1:])
    sums.index_add_(0, members, values * weights.view(shape))
    total = weights.new_zeros(count).index_add_(0, members, weights)
    means = sums / total.view(shape)
    single = (members.bincount(minlength=count) == 1)[members]
    return means.index_copy_(0, members[single], values[single])

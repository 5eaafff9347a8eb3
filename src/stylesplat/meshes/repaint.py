"""Paint on a texture: the objective of `stylize`, with texels in the place of Gaussians.

A pixel is linear in the texels, as it is in the colours of Gaussians, so that the optimiser is the
same. Strokes are as sharp as texels, which are finer than Gaussians. What is painted on a texel
also tints its neighbours: what a view shows between texels is then nearly what it shows on them,
and the objective does not undo the view's own blur with grain in the texture.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from stylesplat.imaging.color import build_palette
from stylesplat.meshes.rasterize import NOTHING, draw_mesh
from stylesplat.meshes.surface import MeshViews, face_areas
from stylesplat.meshes.texture import Texels, TexturedMesh, texels_of
from stylesplat.options import with_settings
from stylesplat.progress import task
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import COVERED
from stylesplat.scene.layers import Layer
from stylesplat.scene.splats import Splats, rgb_from_sh0, sh0_from_rgb
from stylesplat.stylization.config import STYLE_PRESETS, WINDOW, Stage, without_retired
from stylesplat.stylization.features import Cells
from stylesplat.stylization.form import survey_detail
from stylesplat.stylization.guides import Guides
from stylesplat.stylization.optimize import optimize_colors, stage_objective
from stylesplat.stylization.painting import PaintSetup, load_network, paint_setup
from stylesplat.stylization.style import KEPT_HUES, Style, all_colors, style_pictures
from stylesplat.stylization.views import (
    BOX_MARGIN,
    MIN_CELLS,
    VISITS_OF_WINDOWS,
    ObjectBox,
    PaintView,
    crop_to_box,
    find_boxes,
    typical_length,
    windows,
)

REPAINT_STEPS = 120  # at least
TEXEL_RATE = 0.2  # factor of the rate: Adam moves every texel as far, and more looks grainy
REPAINT_COVER = 1.5  # pixels of all windows, for each of the surface's: windows overlap
REPAINT_LONGEST = 960.0  # pixels of the object's longer side: steps grow with their square


@dataclass(frozen=True, eq=False)
class TexelView(PaintView):
    """A view of a mesh as a function of its texels."""

    matrix: csr_array
    """The weight of each texel [L] in each pixel."""
    texels: Int[Tensor, " L"]
    """The rows of the texels."""
    count: int
    """How many texels there are in all."""
    background: Float[Tensor, "H W 3"]
    """What the pixels show besides."""

    def render(self, colors: Float[Tensor, "P 3"]) -> Float[Tensor, "H W 3"]:
        own = rgb_from_sh0(colors.index_select(0, self.texels))
        return _Product.apply(own, self.matrix).view_as(self.background) + self.background

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "P D"]:
        sums = torch.from_numpy(self.matrix.T @ image.flatten(0, 1).numpy())
        return image.new_zeros(self.count, image.shape[-1]).index_add_(0, self.texels, sums)


class _Product(Function):
    @staticmethod
    def forward(ctx, colors, matrix):
        ctx.matrix = matrix
        return torch.from_numpy(matrix @ colors.detach().numpy())

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image):
        return torch.from_numpy(ctx.matrix.T @ v_image.numpy()), None


@torch.no_grad()
def repaint(
    mesh: TexturedMesh,
    unpainted: Splats,
    views: MeshViews,
    layer: Layer,
    name: str,
    *,
    style: Style | None = None,
) -> TexturedMesh:
    """Paint the texture anew, from the paint that it has; `unpainted` gives the object's form.

    The style is by default that of the layer's files.
    """
    texels = texels_of(mesh)
    setup, style = _setup(unpainted, views, layer, style)
    config, every = style.config, torch.ones(len(unpainted), dtype=torch.bool)
    boxes = find_boxes(unpainted, setup.cameras, every)
    side, area = np.ptp(mesh.vertices, axis=0).max(), face_areas(mesh.vertices, mesh.faces).sum()
    length = min(REPAINT_LONGEST, float(side) * math.sqrt(len(texels.points) / area))
    (*_, last) = config.stages(float(setup.cameras.sizes.max()))
    pixels = area * (length / side) ** 2
    steps = max(REPAINT_STEPS, VISITS_OF_WINDOWS * math.ceil(REPAINT_COVER * pixels / WINDOW**2))
    stage = Stage(length, steps, WINDOW, last.rate, fine=True)
    before = torch.from_numpy(mesh.texture[texels.inside])
    images = style_pictures(style.read(), config, before if config.color in KEPT_HUES else None)
    palette = None if config.color == "free" else build_palette(all_colors(images))
    detail = survey_detail(unpainted, every, boxes)
    guides = Guides.of(config, setup.splats, every)
    objective = stage_objective(
        setup, config, images, stage, detail, palette, rate=TEXEL_RATE, guides=guides
    )
    mixing = _mixing(texels)
    cells = setup.network.cells(config.block)
    found = _texel_views(mesh, texels, mixing, cells, boxes, stage, config.seed)
    colors = painted = sh0_from_rgb(before)
    targets = objective.targets(found, unpainted, colors)
    with task(f"{name}'s texture", steps) as bar:
        results = optimize_colors(colors, targets, objective, steps, seed=config.seed)
        for painted, nnfm in results:  # noqa: B007  (the last is used)
            bar.advance()
            bar.note(f"NNFM {nnfm:.3f}")
    painted = colors + torch.from_numpy(mixing @ (painted - colors).numpy())
    painted = rgb_from_sh0(colors.lerp(painted, min(layer.strength, 1.0)))
    texture = mesh.texture.copy()
    texture[texels.inside] = painted.clamp(0, 1).numpy()
    return replace(mesh, texture=texture[texels.nearest])


def _setup(
    unpainted: Splats, views: MeshViews, layer: Layer, style: Style | None
) -> tuple[PaintSetup, Style]:
    config = with_settings(STYLE_PRESETS["default"], without_retired(layer.settings))
    if style is None:
        files = [source.path for source in layer.styles]
        style = Style(*(file for file in files if file is not None), config=config)
    network = load_network(layer.features, layer.weights, depth=config.block)
    cameras = views.cameras[views.trusted.nonzero()[0].tolist()]
    return paint_setup(unpainted, cameras, network), style


def _texel_views(
    mesh: TexturedMesh,
    texels: Texels,
    mixing: csr_array,
    cells: Cells,
    boxes: Sequence[ObjectBox],
    stage: Stage,
    seed: int,
) -> list[TexelView]:
    """Windows of the mesh; those that hardly show it are skipped."""
    zoom, size = stage.length / typical_length(boxes), len(mesh.texture)
    rows = texels.rows[texels.nearest]
    count = math.ceil(stage.steps / VISITS_OF_WINDOWS)
    generator = torch.Generator().manual_seed(seed)
    surface = torch.from_numpy(texels.points), torch.from_numpy(texels.normals)
    places = windows(boxes, WINDOW / zoom, count, generator, surface)
    before = mesh.texture[texels.inside]
    grey, unmixed = torch.from_numpy(before.mean(axis=0)), before - mixing @ before

    def look(box: ObjectBox) -> TexelView:
        camera, inside = crop_to_box(box, zoom, (BOX_MARGIN, BOX_MARGIN))
        fragments = draw_mesh(mesh.vertices, mesh.faces, camera)
        covered = torch.from_numpy(fragments.faces != NOTHING)
        own = F.avg_pool2d((covered & inside).float()[None], cells.stride)[0] > COVERED
        corners = fragments.of_corners(mesh.uvs, mesh.faces) * size
        matrix, used = _texel_weights(corners, rows, covered)
        background = grey * ~covered[..., None]
        background += torch.from_numpy(matrix @ unmixed[used]).view_as(background)
        matrix, used = _without_unused(matrix @ mixing[used])
        return TexelView(
            camera, own, covered, matrix, torch.from_numpy(used), len(texels.points), background
        )

    found = per_view(look, places, "preparing the texture's views")
    return [view for view in found if view.cells.sum() >= MIN_CELLS]


def _mixing(texels: Texels) -> csr_array:
    """What each texel takes from itself and its neighbours: 1 to 2 to 1 across and down."""
    count, size = len(texels.points), len(texels.rows)
    rows = np.pad(texels.rows, 1, constant_values=NOTHING)
    weights = csr_array((count, count), dtype=np.float32)
    for i, j in product(range(3), repeat=2):
        near = rows[i : i + size, j : j + size][texels.inside]
        (own,) = (near != NOTHING).nonzero()
        share = np.full(len(own), (1, 2, 1)[i] * (1, 2, 1)[j], np.float32)
        weights += csr_array((share, (own, near[own])), shape=weights.shape)
    return csr_array(weights.multiply(1 / weights.sum(axis=1)[:, None]))


def _texel_weights(
    places: Float[np.ndarray, "P 2"], rows: Int[np.ndarray, "S S"], covered: Tensor
) -> tuple[csr_array, Int[np.ndarray, " L"]]:
    """The weights of texels in pixels that lie at some places of the texture, and their rows."""
    low = np.clip(places - 0.5, 0, len(rows) - 1.001)
    corner = low.astype(int)
    right, down = (low - corner).T
    found, weights = [], []
    for i, part in ((0, 1 - down), (1, down)):
        for j, share in ((0, 1 - right), (1, right)):
            found.append(rows[corner[:, 1] + i, corner[:, 0] + j])
            weights.append(part * share)
    pixels = np.tile(covered.flatten().nonzero()[:, 0].numpy(), 4)
    values = np.concatenate(weights).astype(np.float32)
    shape = (covered.numel(), int(rows.max()) + 1)
    return _without_unused(csr_array((values, (pixels, np.concatenate(found))), shape=shape))


def _without_unused(matrix: csr_array) -> tuple[csr_array, Int[np.ndarray, " L"]]:
    """A matrix without its empty columns, and the numbers of the others."""
    used, columns = np.unique(matrix.indices, return_inverse=True)
    shape = (len(matrix.indptr) - 1, len(used))
    return csr_array((matrix.data, columns, matrix.indptr), shape=shape), used

"""Paint on a texture: the objective of `stylize`, with texels in the place of Gaussians.

A pixel is linear in the texels, as it is in the colours of Gaussians, so that the optimiser is the
same. Strokes are as sharp as texels, which are finer than Gaussians.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from stylesplat.rendering.weights import COVERED
from stylesplat.scene.layers import Layer
from stylesplat.scene.splats import Splats, rgb_from_sh0, sh0_from_rgb
from stylesplat.stylization.config import PRESETS, WINDOW, Stage, without_retired
from stylesplat.stylization.objective import Objective
from stylesplat.stylization.optimize import (
    optimize_colors,
    stage_objective,
    style_pictures,
    survey_detail,
)
from stylesplat.stylization.style import Style, all_colors
from stylesplat.stylization.target import PaintContext, load_network, paint_context
from stylesplat.stylization.views import (
    MARGIN,
    MIN_CELLS,
    VISITS_OF_WINDOWS,
    Box,
    ObjectView,
    crop_to_box,
    find_boxes,
    per_view,
    typical_length,
    windows,
)

STEPS = 120
LONGEST = 1600.0  # pixels of the object's longer side: finer strokes nobody sees


@dataclass(frozen=True, eq=False)
class TexelView(ObjectView):
    """A view of a mesh as a function of its texels, which stand for Gaussians."""

    matrix: csr_array | None = None
    """The weight of each texel [L] in each pixel."""
    texels: Int[Tensor, " L"] | None = None
    """The rows of the texels."""
    background: Float[Tensor, "H W 3"] | None = None

    def render(self, splats: Splats) -> Float[Tensor, "H W 3"]:
        """The image with the colours of these texels, which gradients reach."""
        assert self.texels is not None and self.background is not None
        colors = rgb_from_sh0(splats.sh0.index_select(0, self.texels)[:, 0])
        return _Product.apply(colors, self.matrix).view_as(self.background) + self.background

    def backproject(self, splats: Splats, image: Float[Tensor, "H W D"]) -> Float[Tensor, "N D"]:
        """The sum of an image times the weights of each texel."""
        assert self.texels is not None and self.matrix is not None
        sums = torch.from_numpy(self.matrix.T @ image.flatten(0, 1).numpy())
        return image.new_zeros(len(splats), image.shape[-1]).index_add_(0, self.texels, sums)


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
    mesh: TexturedMesh, unpainted: Splats, views: MeshViews, layer: Layer, name: str
) -> TexturedMesh:
    """Paint the texture anew, from the paint that it has.

    Args:
        mesh: The mesh with the paint of the Gaussians.
        unpainted: The object alone before it was painted, for its form.
        views: From where to paint.
        layer: The object's paint: its style, whose pictures are there, and settings.
        name: What messages call the object.
    """
    texels = texels_of(mesh)
    paint = _as_splats(mesh, texels)
    context, style = _context(unpainted, views, layer)
    boxes = find_boxes(unpainted, context.cameras, torch.ones(len(unpainted), dtype=torch.bool))
    side, area = np.ptp(mesh.vertices, axis=0).max(), face_areas(mesh.vertices, mesh.faces).sum()
    length = min(LONGEST, float(side) * math.sqrt(len(texels.points) / area))
    photo_length = float(context.cameras.sizes.max())
    (*_, last) = style.config.stages(photo_length)
    stage = Stage(length, STEPS, WINDOW, last.rate, fine=True)
    objective = _objective(context, style, stage, boxes, mesh.texture[texels.inside])
    generator = torch.Generator().manual_seed(style.config.seed)
    seen = _texel_views(mesh, texels, objective, boxes, stage, generator)
    targets = objective.targets(seen, unpainted, paint)
    every, sh0 = torch.ones(len(paint), dtype=torch.bool), paint.sh0
    with task(f"{name}'s texture", STEPS) as bar:
        for painted, nnfm in optimize_colors(paint, every, targets, objective, STEPS):
            bar.advance()
            bar.note(f"NNFM {nnfm:.3f}")
            sh0 = painted.sh0
    sh0 = paint.sh0.lerp(sh0, min(layer.strength, 1.0))
    texture = mesh.texture.copy()
    texture[texels.inside] = rgb_from_sh0(sh0[:, 0]).clamp(0, 1).numpy()
    return replace(mesh, texture=texture[texels.nearest])


def _as_splats(mesh: TexturedMesh, texels: Texels) -> Splats:
    """Texels as Gaussians, whose colours alone count."""
    count = len(texels.points)
    colors = torch.from_numpy(mesh.texture[texels.inside])
    return Splats(
        means=torch.from_numpy(texels.points),
        quats=torch.zeros(1, 4).expand(count, 4),
        scales=torch.zeros(1, 3).expand(count, 3),
        opacities=torch.zeros(1).expand(count),
        sh0=sh0_from_rgb(colors)[:, None],
        shN=torch.zeros(count, 0, 3),
    )


def _context(unpainted: Splats, views: MeshViews, layer: Layer) -> tuple[PaintContext, Style]:
    files = [source.path for source in layer.styles]
    config = with_settings(PRESETS["default"], without_retired(layer.settings))
    style = Style(*(file for file in files if file is not None), config=config)
    network = load_network([style], layer.features, layer.weights)
    cameras = views.cameras[views.trusted.nonzero()[0].tolist()]
    return paint_context(unpainted, cameras, network), style


def _objective(
    context: PaintContext,
    style: Style,
    stage: Stage,
    boxes: Sequence[Box],
    colors: Float[np.ndarray, "T 3"],
) -> Objective:
    config = style.config
    own = torch.from_numpy(colors) if config.color in ("blend", "keep") else None  # as painted
    pictures = style_pictures(style.read(), config, own)
    mask = torch.ones(len(context.splats), dtype=torch.bool)
    return stage_objective(
        context,
        config,
        pictures,
        stage,
        survey_detail(context.splats, mask, boxes),
        None if config.color == "free" else build_palette(all_colors(pictures)),
        is_fine_surface=True,
    )


def _texel_views(
    mesh: TexturedMesh,
    texels: Texels,
    objective: Objective,
    boxes: Sequence[Box],
    stage: Stage,
    generator: torch.Generator,
) -> list[TexelView]:
    """Windows of the mesh; those that hardly show it are skipped."""
    zoom, size = stage.length / typical_length(boxes), len(mesh.texture)
    rows = np.full((size, size), -1, np.int32)
    rows[texels.inside] = np.arange(len(texels.points))
    rows = rows[texels.nearest]
    cells = objective.network.cells(objective.config.block)
    count = math.ceil(stage.steps / VISITS_OF_WINDOWS)
    places = windows(boxes, WINDOW / zoom, count, generator)
    grey = torch.from_numpy(mesh.texture[texels.inside].mean(axis=0))

    def look(box: Box) -> TexelView:
        camera, inside = crop_to_box(box, zoom, (MARGIN, MARGIN))
        fragments = draw_mesh(mesh.vertices, mesh.faces, camera)
        covered = torch.from_numpy(fragments.faces != NOTHING)
        own = (covered & inside).float()
        matrix, used = _texel_weights(
            fragments.of_corners(mesh.uvs, mesh.faces) * size, rows, covered
        )
        mask = F.avg_pool2d(own[None], cells.stride)[0] > COVERED
        background = grey * ~covered[..., None]
        return TexelView(camera, mask, covered, matrix=matrix, texels=used, background=background)

    found = per_view(look, places, "preparing the texture's views")
    return [view for view in found if view.cells.sum() >= MIN_CELLS]


def _texel_weights(
    places: Float[np.ndarray, "P 2"], rows: Int[np.ndarray, "S S"], covered: Tensor
) -> tuple[csr_array, Int[Tensor, " L"]]:
    """The weights of texels in pixels that lie at some places of the texture, and their rows."""
    low = np.clip(places - 0.5, 0, len(rows) - 1.001)
    corner = low.astype(int)
    right, down = (low - corner).T
    found, weights = [], []
    for i, part in ((0, 1 - down), (1, down)):
        for j, share in ((0, 1 - right), (1, right)):
            found.append(rows[corner[:, 1] + i, corner[:, 0] + j])
            weights.append(part * share)
    used, columns = np.unique(np.concatenate(found), return_inverse=True)
    pixels = np.tile(covered.flatten().nonzero()[:, 0].numpy(), 4)
    values = np.concatenate(weights).astype(np.float32)
    matrix = csr_array((values, (pixels, columns)), shape=(covered.numel(), len(used)))
    return matrix, torch.from_numpy(used.astype(np.int64))

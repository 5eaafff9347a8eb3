"""Linear rendering: with geometry and opacities frozen, an image is linear in the colours.

`I = B + W c`: W holds what each picked Gaussian contributes to each pixel (alpha times
transmittance), B is the image of everything else. One pass of the CPU rasteriser yields both;
after that an image costs a sparse product. On a GPU W stays implicit: rasterising the Gaussians
that reach the image reads fewer bytes than W has (docs/scale.md); and where W would not fit.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numba import get_num_threads
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from stylesplat.rendering import cpu
from stylesplat.rendering.gaussians import with_matrices_of
from stylesplat.rendering.kernels import linear_blocks, vec
from stylesplat.rendering.kernels.linear_blocks import BlockWeights
from stylesplat.rendering.render import colors_of, rasterize
from stylesplat.rendering.shares import contributed, coverage, without_looks
from stylesplat.rendering.visibility import in_view, visible
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layer import without_identities
from stylesplat.scene.splats import SH_C0, Splats

LARGEST_VIEW = 1e9  # bytes of kept weights; a photo of 4K that is all object has half of them


@dataclass(frozen=True, eq=False)
class Contributions:
    """One camera's image as a function of the colours of some Gaussians."""

    gaussians: Int[Tensor, " M"]
    """Rows of the picked Gaussians that are visible."""
    background: Float[Tensor, "H W 3"]
    """The image of everything else, as far as the picked Gaussians do not hide it."""
    coverage: Float[Tensor, "H W"]
    """The opaque share of the picked Gaussians in each pixel: the row sums of the weights."""
    origin: Float[Tensor, "1 3"]
    """The camera's position: colours depend on the direction."""
    blocks: BlockWeights
    """The weights."""
    is_matte: bool = False
    """Whether the picked Gaussians have no higher bands."""

    @property
    def size(self) -> tuple[int, int]:
        return self.background.shape[1], self.background.shape[0]

    @property
    def nbytes(self) -> int:
        images = self.background.nbytes + self.coverage.nbytes
        return images + self.gaussians.nbytes + sum(array.nbytes for array in self.blocks)

    def image(self, colors: Float[Tensor, "M 3"]) -> Float[Tensor, "H W 3"]:
        """The image when the Gaussians have these colours, which gradients reach."""
        return _Compose.apply(colors, self)

    def render(self, splats: Splats, *, clamp: bool = True) -> Float[Tensor, "H W 3"]:
        """The image with the colours of these splats, which gradients reach.

        The splats differ from the scene at most in the colours of the picked Gaussians.
        """
        visible = self.gaussians
        if self.is_matte:
            colors = splats.sh0[:, 0].index_select(0, visible) * SH_C0 + 0.5  # quicker than []
            return self.image(colors.relu() if clamp else colors)
        dirs = splats.means[visible] - self.origin
        sh = splats.sh0[visible], splats.shN[visible]
        return self.image(cpu.spherical_harmonics(splats.sh_degree, dirs, *sh, clamp=clamp))

    def composite(self, values: Float[Tensor, "M 3"]) -> Float[Tensor, "H W 3"]:
        """Numbers of the picked Gaussians in the place of their colours, before nothing."""
        return replace(self, background=torch.zeros_like(self.background)).image(values)

    def as_matte(self) -> "Contributions":
        """The same for picked Gaussians without higher bands, which is quicker."""
        return replace(self, is_matte=True)

    def weights(self, pixels: Bool[Tensor, "H W"] | None = None) -> Float[Tensor, " M"]:
        """Each Gaussian's contribution to some pixels, or to all: column sums of the weights."""
        counted = torch.ones_like(self.background)
        if pixels is not None:
            counted *= pixels[:, :, None]
        return self.backproject(counted)[:, 0]

    def backproject(self, image: Float[Tensor, "H W 3"]) -> Float[Tensor, "M 3"]:
        """The transpose of rendering: an image times the weights of each Gaussian, summed."""
        partial = cpu.partial_sums(len(self.gaussians), vec.LANES)
        flat = image.contiguous().view(-1).numpy()
        linear_blocks.compose_backward(self.blocks, flat, self.size, partial.flatten(1).numpy())
        return partial.sum(dim=0)[:, :3]


@dataclass(frozen=True, eq=False)
class RasterizedContributions:
    """The same without weights: on a GPU it is rasterised again for every question."""

    scene: Splats
    """Whose geometry and opacities stay."""
    camera: Cameras
    near: Int[Tensor, " L"]
    """Rows of the Gaussians that reach the image."""
    is_picked: Bool[Tensor, " L"]
    """Which of them are picked."""
    coverage: Float[Tensor, "H W"]
    """The opaque share of the picked Gaussians in each pixel."""
    nbytes: int = 0
    """Nothing is kept."""

    @property
    def gaussians(self) -> Int[Tensor, " M"]:
        """Rows of the picked Gaussians that are visible."""
        return self.near[self.is_picked]

    def render(self, splats: Splats) -> Float[Tensor, "H W 3"]:
        """The image with the colours of these splats; see `Contributions.render`."""
        near = without_identities(splats).map(lambda tensor: tensor.index_select(0, self.near))
        return rasterize(near, self.camera)[0][0]

    def composite(self, values: Float[Tensor, "M 3"]) -> Float[Tensor, "H W 3"]:
        """Numbers of the picked Gaussians; see `Contributions.composite`."""
        places = self.is_picked.nonzero()[:, 0]
        features = values.new_zeros(len(self.near), 3).index_copy(0, places, values)
        near = without_looks(self.scene)[self.near]
        return rasterize(near, self.camera, features=features)[0][0, ..., 3:]

    def as_matte(self) -> "RasterizedContributions":
        """Itself: that saves no time here."""
        return self

    def weights(self, pixels: Bool[Tensor, "H W"] | None = None) -> Float[Tensor, " M"]:
        """Each Gaussian's contribution to some pixels, or to all."""
        counted = torch.ones_like(self.coverage) if pixels is None else pixels.to(self.coverage)
        return self.backproject(counted[..., None])[:, 0]

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "M D"]:
        """The transpose of rendering; see `Contributions.backproject`."""
        near = without_looks(self.scene)[self.near]
        return contributed(near, self.camera, image)[self.is_picked]


@torch.no_grad()
def contributions(
    splats: Splats,
    camera: Cameras,
    picked: Bool[Tensor, " N"],
    pixels: Bool[Tensor, "H W"] | None = None,
) -> Contributions:
    """Render everything but some Gaussians, and keep the contributions of these.

    Args:
        splats: The scene, on the CPU.
        camera: One camera.
        picked: The Gaussians whose colours are to vary.
        pixels: The pixels wanted, which have to contain all that picked Gaussians may reach; others
            need not be right. All by default.
    """
    view = _kept(splats, camera, picked, pixels, np.inf)
    assert view is not None, "all weights fit"
    return view


def _kept(
    splats: Splats,
    camera: Cameras,
    picked: Bool[Tensor, " N"],
    pixels: Bool[Tensor, "H W"] | None,
    max_bytes: float,
) -> Contributions | None:
    """The `contributions`, unless the weights take more bytes."""
    near = in_view(splats, camera, pixels)
    mine = picked[near.rows]
    others = (~mine).nonzero()[:, 0]
    colors = mine[:, None].to(splats.means) * splats.means.new_tensor([0.0, 0.0, 0.0, 1.0])
    origin = with_matrices_of(splats, camera).positions
    colors[others, :3] = colors_of(splats, near.rows[others], origin)
    tiled, image, _ = cpu.rasterize_to_pixels(near.projected, colors, camera.size)
    drawn = cpu.reaching(tiled) & mine.numpy()[tiled.order]
    numbers = np.where(drawn, np.cumsum(drawn) - 1, -1).astype(np.int32)  # by rank
    background, coverage = image.split((3, 1), dim=2)
    blocks = _block_weights(tiled, numbers, camera.size, max_bytes)
    if blocks is None:
        return None
    return Contributions(
        gaussians=near.rows[torch.from_numpy(tiled.order[drawn].astype(np.int64))],
        background=background.contiguous(),
        coverage=coverage[:, :, 0].contiguous(),
        origin=camera.positions.to(splats.means),
        blocks=blocks,
    )


LinearView = Contributions | RasterizedContributions
"""One camera's image as a function of the colours of some Gaussians, on any device."""


@torch.no_grad()
def linear_view(
    splats: Splats,
    camera: Cameras,
    picked: Bool[Tensor, " N"],
    pixels: Bool[Tensor, "H W"] | None = None,
    *,
    max_bytes: float = LARGEST_VIEW,
) -> LinearView:
    """The `contributions` of some Gaussians to one camera's image, on the splats' device.

    Weights that take more bytes are not kept.
    """
    if splats.device.type == "cpu":
        view = _kept(splats, camera, picked, pixels, max_bytes)
        if view is not None:
            return view
    camera = with_matrices_of(splats, camera)  # once, not in every step
    near = visible(in_view(splats, camera), camera).rows
    covered = coverage(splats, camera, picked)
    return RasterizedContributions(splats, camera, near, picked[near], covered)


def _block_weights(
    tiled: cpu.Tiled, numbers: np.ndarray, size: tuple[int, int], max_bytes: float
) -> BlockWeights | None:
    starts, firsts = np.zeros((2, len(tiled.lists.starts)), np.int64)
    linear_blocks.count_pairs(tiled.lists, numbers, starts, firsts)
    if 2 * vec.LANES * int(firsts[-1]) > max_bytes:  # float16
        return None
    gaussians, masks = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.uint16)
    weights = np.empty(firsts[-1] * vec.LANES, np.uint16)
    blocks = BlockWeights(starts, firsts[:-1].copy(), gaussians, masks, weights)
    threads = get_num_threads()
    linear_blocks.store_weights(tiled.rows, tiled.lists, numbers, size, blocks, threads)
    return blocks


class _Compose(Function):
    @staticmethod
    def forward(ctx, colors, view):
        image = torch.empty_like(view.background)
        rows = torch.nn.functional.pad(colors.detach(), (0, 1)).view(-1)
        linear_blocks.render_linear(
            view.blocks,
            rows.numpy(),
            view.background.view(-1).numpy(),
            image.view(-1).numpy(),
            view.size,
            get_num_threads(),
        )
        ctx.view = view
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx, v_image):
        return ctx.view.backproject(v_image), None

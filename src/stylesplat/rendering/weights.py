"""Whose pixels: the weights W [H W, N] of Gaussians in the pixels of a view, as linear maps.

A weight is alpha times transmittance. `composite` is W V and `backproject` is its adjoint W^T V;
`pixels_in` sums that over views. With geometry and opacities frozen an image is linear in the
colours: `contributions` has `I = B + W c` for the Gaussians of an object. On the CPU one pass of
the rasteriser yields B and W, after which an image costs a sparse product; on a GPU, and where W
would not fit, W stays implicit: rasterising the Gaussians that reach the image reads fewer bytes
than W has (docs/scale.md).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from scipy.ndimage import find_objects
from scipy.sparse import csc_array, csr_array
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.interrupts import raise_if_interrupted
from stylesplat.rendering.reference import Backend, with_matrices_of
from stylesplat.rendering.render import colors_of, render
from stylesplat.rendering.visibility import (
    CHANNELS_PER_PASS,
    VISIBLE_LARGE,
    VISIBLE_MANY,
    InView,
    TiledView,
    bounds,
    in_view,
    project_splats,
    tiled,
    touching,
    visible,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, ids_of
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import Splats

MAX_WEIGHT_BYTES = 1e9  # of stored weights; a photo of 4K that is all object has half of them
NOBODY = -1  # no label
TALL = 0.25  # of a view, beyond which a label counts as tall
COVERED = 0.5  # the opaque share from which a pixel or a feature is an object's
TINY_COVERAGE = 1e-6  # of a pixel, below which an average over it is undefined
PRIOR = 0.02  # pixels of background that every Gaussian has: hidden ones have hardly more


def geometry_only(splats: Splats) -> Splats:
    """The splats without higher bands and identities, which is enough for weights."""
    return replace(splats, shN=splats.shN[:, :0], identities=None, confidence=None)


def composite(
    splats: Splats,
    camera: Cameras,
    values: Float[Tensor, "N K"],
    pixels: Bool[Tensor, "H W"] | None = None,
    *,
    backend: Backend = "auto",
) -> Float[Tensor, "H W K"]:
    """Composite values of Gaussians, such as their shares of labels, like colours before nothing.

    Gradients reach the values. With `pixels` others need not be right.
    """
    if _is_taken_whole(splats):
        return _whole_view(splats, camera, backend).composite(values)
    near = in_view(splats, camera, pixels, backend)
    if len(near.rows) > VISIBLE_MANY:
        near = visible(near, camera)
    view = tiled(near.projected, camera.size, backend)
    return view.composite(values.index_select(0, near.rows))


@torch.no_grad()
def backproject(
    splats: Splats,
    camera: Cameras,
    image: Float[Tensor, "H W K"],
    *,
    backend: Backend = "auto",
) -> Float[Tensor, "N K"]:
    """Sum an image over its pixels, times the weights of each Gaussian: adjoint to `composite`."""
    if _is_taken_whole(splats):
        return _whole_view(splats, camera, backend).backproject(image)
    counted = (image != 0).any(dim=-1)
    near = in_view(splats, camera, None if counted.all() else counted, backend)
    sums = tiled(near.projected, camera.size, backend).backproject(image)
    return sums.new_zeros(len(splats), sums.shape[1]).index_copy_(0, near.rows, sums)


def _is_taken_whole(splats: Splats) -> bool:
    """Whether all Gaussians are sorted into tiles, in view or not.

    A GPU takes less time for that than the host waits to hear which ones are in view.
    """
    return splats.device.type != "cpu" and len(splats) < VISIBLE_LARGE


def _whole_view(splats: Splats, camera: Cameras, backend: Backend) -> TiledView:
    raise_if_interrupted()
    return tiled(project_splats(splats, camera, backend=backend), camera.size, backend)


def pixels_in(
    splats: Splats,
    cameras: Iterable[Cameras],
    masks: Iterable[Shaped[Tensor, "H W *K"]],
    *,
    backend: Backend = "auto",
) -> Float[Tensor, "N *K"]:
    """How many pixels of some masks each Gaussian makes up, summed over views.

    Args:
        splats: The scene.
        cameras: Single views, as `Cameras` are if iterated over.
        masks: Of each view, on any device; numbers say how much a pixel counts.
        backend: As `rasterize` takes it.
    """
    total = torch.zeros(())
    for camera, mask in zip(cameras, masks, strict=True):
        image = mask.to(splats.means).reshape(*mask.shape[:2], -1)
        sums = backproject(splats, camera, image, backend=backend)
        total = total.to(sums) + sums.reshape(len(splats), *mask.shape[2:])
    return total


@torch.no_grad()
def label_pixels(
    splats: Splats,
    cameras: Cameras,
    label_maps: Iterable[tuple[int, Int[Tensor, "H W"]]],
) -> tuple[tuple[int, ...], csr_array]:
    """Sparse `pixels_in` of labels: each Gaussian contributes to few, however many there are.

    Args:
        splats: The scene.
        cameras: Views of it.
        label_maps: Rows of cameras, and the labels of their pixels, `NOBODY` for none.

    Returns:
        The ids that occur, background first, and the pixels of each that each Gaussian makes up,
        [N, K].
    """
    columns, total = {BACKGROUND: 0}, csr_array((len(splats), 1), dtype=np.float32)
    for row, labels in label_maps:
        camera, near = cameras[row], in_view(splats, cameras[row])
        for ids in (passes := _label_passes(labels)):
            wanted, part = labels[..., None] == labels.new_tensor(ids), near
            if len(passes) > 1:
                marked = wanted.any(dim=-1).to(splats.device)
                part = near.some(touching(*bounds(near.projected), marked).nonzero()[:, 0])
            pixels = tiled(part.projected, camera.size).backproject(wanted.to(splats.means))
            entries, which = pixels.nonzero(as_tuple=True)
            own = np.array([columns.setdefault(id, len(columns)) for id in ids])
            places = part.rows[entries].cpu().numpy(), own[which.cpu().numpy()]
            values = pixels[entries, which].cpu().numpy()
            more = csr_array((values, places), shape=(len(splats), len(columns)))
            more.sort_indices()  # sums of sorted ones need no sorting
            total.resize(more.shape)
            total = csr_array(total + more)
    ids = tuple(sorted(columns))
    return ids, total[:, [columns[id] for id in ids]]


def _label_passes(labels: Int[Tensor, "H W"]) -> list[list[int]]:
    """The label ids of a view, in as many groups as passes over it take.

    Those of a group lie at one height, so that few Gaussians reach them: many small labels take not
    much longer than few large ones. Tall labels have groups of their own.
    """
    ids = sorted(ids_of(labels))
    if len(ids) > CHANNELS_PER_PASS:
        numbers = torch.searchsorted(labels.new_tensor(ids), labels).cpu().numpy()
        spans = {id: window[0] for id, window in zip(ids, find_objects(numbers + 1), strict=True)}
        tall = TALL * len(labels)
        ids.sort(key=lambda id: -1 if spans[id].stop - spans[id].start > tall else spans[id].start)
    ids = [id for id in ids if id != NOBODY]
    return [ids[k : k + CHANNELS_PER_PASS] for k in range(0, len(ids), CHANNELS_PER_PASS)]


@torch.no_grad()
def render_argmax(
    splats: Splats, camera: Cameras, values: csr_array
) -> tuple[Float[Tensor, "H W"], Int[Tensor, "H W"]]:
    """The largest composited value in each pixel, and its column; for values [N, K]."""
    width, height = camera.size
    most, column = torch.full((height, width), -torch.inf), torch.zeros(height, width).long()
    by_column = csc_array(values)
    for columns in torch.arange(len(by_column.indptr) - 1).split(CHANNELS_PER_PASS):
        some = torch.from_numpy(by_column[:, columns.numpy()].toarray()).to(splats.means)
        largest, places = composite(splats, camera, some).cpu().max(dim=-1)
        column = torch.where(largest > most, columns[places], column)
        most = torch.maximum(largest, most)
    return most, column


@torch.no_grad()
def coverage(
    splats: Splats,
    camera: Cameras,
    mask: Bool[Tensor, " N"] | Float[Tensor, " N"] | None = None,
) -> Float[Tensor, "H W"]:
    """The opaque share of an object, or of all, in each pixel of one camera; others may hide it.

    An object's mask may hold the shares of Gaussians that belong to it.
    """
    pixels = None
    if mask is None:
        mask = torch.ones_like(splats.opacities, dtype=torch.bool)
    elif len(splats) >= VISIBLE_LARGE:  # skip the others where it cannot be visible
        pixels = coverage(geometry_only(splats)[mask.nonzero()[:, 0]], camera) > 0
    return composite(splats, camera, mask.to(splats.means)[:, None], pixels)[..., 0]


@torch.no_grad()
def colors_and_coverage(
    splats: Splats, camera: Cameras, mask: Bool[Tensor, " N"]
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W 1"]]:
    """The image of one camera, and an object's share of every pixel."""
    image, _ = render(splats, camera, features=mask.to(splats.means)[:, None])
    return image[..., :3], image[..., 3:]


@torch.no_grad()
def expected_depth(
    splats: Splats, camera: Cameras
) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The expected depth of each pixel of one camera, and its coverage.

    The depth is undefined where hardly anything is visible, and 0 where nothing is.
    """
    depths = depths_of(splats.means, camera)
    values = torch.stack([depths, torch.ones_like(depths)], dim=1)
    summed, alphas = composite(splats, camera, values).unbind(dim=-1)
    return summed / alphas.clamp(min=TINY_COVERAGE), alphas


@dataclass(frozen=True, eq=False)
class Contributions:
    """One camera's image as a linear function of the colours of some Gaussians: I = B + W c.

    Geometry and opacities stay as they were. M Gaussians are visible of the N of the scene.
    """

    count: int
    """N."""
    gaussians: Int[Tensor, " M"]
    """Rows of the visible Gaussians."""
    background: Float[Tensor, "H W 3"]
    """The image of everything else, as far as they do not hide it: B."""
    coverage: Float[Tensor, "H W"]
    """Their opaque share in each pixel: the row sums of W."""

    @property
    def nbytes(self) -> int:
        """Memory of the images, and of what is kept of weights or tiles."""
        return self.gaussians.nbytes + self.background.nbytes + self.coverage.nbytes

    def render(self, colors: Float[Tensor, "M 3"]) -> Float[Tensor, "H W 3"]:
        """The image when the Gaussians have these colours, which gradients reach."""
        return self.background + self.composite(colors)

    def composite(self, values: Float[Tensor, "M D"]) -> Float[Tensor, "H W D"]:
        """Values in the place of colours, before nothing: W V."""
        raise NotImplementedError

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "M D"]:
        """The sum over pixels of an image times the weights of each Gaussian: W^T V."""
        raise NotImplementedError

    def pixels_in(self, masks: Shaped[Tensor, "H W *D"]) -> Float[Tensor, "N *D"]:
        """How many pixels of some masks each Gaussian of the scene makes up; 0 for other ones."""
        image = masks.to(self.coverage).reshape(*self.coverage.shape, -1)
        sums = image.new_zeros(self.count, image.shape[-1])
        sums.index_copy_(0, self.gaussians, self.backproject(image))
        return sums.reshape(self.count, *masks.shape[2:])


@dataclass(frozen=True, eq=False)
class StoredContributions(Contributions):
    """With the weights in memory, as float16; on the CPU."""

    blocks: tuple[np.ndarray, ...]
    """As `BlockWeights`."""

    @property
    def nbytes(self) -> int:
        return super().nbytes + sum(array.nbytes for array in self.blocks)

    def render(self, colors: Float[Tensor, "M 3"]) -> Float[Tensor, "H W 3"]:
        return _cpu().compose_blocks(colors, self.blocks, self.background)

    def composite(self, values: Float[Tensor, "M D"]) -> Float[Tensor, "H W D"]:
        compose, nothing = _cpu().compose_blocks, torch.zeros_like(self.background)
        parts = [compose(some, self.blocks, nothing) for some in _threes(values)]
        return torch.cat(parts, dim=-1)[..., : values.shape[-1]]

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "M D"]:
        back, count = _cpu().backproject_blocks, len(self.gaussians)
        parts = [back(some, self.blocks, count) for some in _threes(image)]
        return torch.cat(parts, dim=-1)[:, : image.shape[-1]]


def _cpu() -> Any:
    """The CPU's functions; their kernels are loaded when they are needed."""
    return import_module("stylesplat.rendering.cpu")


def _threes(values: Float[Tensor, "*B D"]) -> Iterator[Float[Tensor, "*B 3"]]:
    """Three channels at a time, as kernels take them; the last ones may be zeros."""
    yield from (pad(each, (0, 3 - each.shape[-1])) for each in values.split(3, dim=-1))


@dataclass(frozen=True, eq=False)
class TiledContributions(Contributions):
    """Without stored weights: all that is visible is kept projected, on a GPU sorted into tiles."""

    view: TiledView
    """Of these Gaussians and, behind them in memory, of the others."""
    others: int

    @property
    def nbytes(self) -> int:
        return super().nbytes + self.view.nbytes

    def composite(self, values: Float[Tensor, "M D"]) -> Float[Tensor, "H W D"]:
        return self.view.composite(pad(values, (0, 0, 0, self.others)))

    def backproject(self, image: Float[Tensor, "H W D"]) -> Float[Tensor, "M D"]:
        return self.view.backproject(image)[: len(self.gaussians)]


@torch.no_grad()
def contributions(
    splats: Splats,
    camera: Cameras,
    mask: Bool[Tensor, " N"],
    pixels: Bool[Tensor, "H W"] | None = None,
    *,
    max_bytes: float = MAX_WEIGHT_BYTES,
) -> Contributions:
    """Render everything but some Gaussians, and get the contributions of these.

    Args:
        splats: The scene.
        camera: One camera.
        mask: The Gaussians whose colours are to vary.
        pixels: The pixels wanted, which have to contain all that these Gaussians may reach; others
            need not be right. All by default.
        max_bytes: Weights that take more are not stored.
    """
    camera = with_matrices_of(splats, camera)  # once, not in every step
    if _is_taken_whole(splats):
        everyone = torch.arange(len(splats), device=splats.device)
        near = InView(everyone, project_splats(splats, camera))
    else:
        near = in_view(splats, camera, pixels)
    if splats.device.type != "cpu":
        return _tiled_contributions(splats, camera, mask, near)
    mine, cpu = mask[near.rows], _cpu()
    # Black for these Gaussians, the others' colours; and 1 for these, as their coverage
    others = (~mine).nonzero()[:, 0]
    colors = mine[:, None].to(splats.means) * splats.means.new_tensor([0.0, 0.0, 0.0, 1.0])
    colors[others, :3] = colors_of(splats, near.rows[others], camera.positions)
    lists, image, _ = cpu.rasterize_to_pixels(near.projected, colors, camera.size)
    drawn = cpu.reaching(lists) & mine.numpy()[lists.order]
    numbers = np.where(drawn, np.cumsum(drawn) - 1, -1).astype(np.int32)  # by rank
    blocks = cpu.store_contributions(lists, numbers, camera.size, max_bytes)
    rows = near.rows[torch.from_numpy(lists.order[drawn].astype(np.int64))]
    if blocks is not None:
        return StoredContributions(len(splats), rows, *_split(image), blocks)
    return _tiled_contributions(splats, camera, mask, near)


def _tiled_contributions(
    splats: Splats, camera: Cameras, mask: Bool[Tensor, " N"], near: InView
) -> TiledContributions:
    raise_if_interrupted()
    near = near.some(mask[near.rows].byte().argsort(descending=True, stable=True))
    mine = mask[near.rows]
    colors = colors_of(splats, near.rows, camera.positions).masked_fill(mine[:, None], 0)
    view = tiled(near.projected, camera.size)
    image = view.composite(torch.cat([colors, mine[:, None].to(colors)], dim=1))
    near = visible(near, camera, view)
    rows = near.rows[mask[near.rows]]
    view = tiled(near.projected, camera.size)
    return TiledContributions(len(splats), rows, *_split(image), view, len(near.rows) - len(rows))


def _split(image: Float[Tensor, "H W 4"]) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W"]]:
    return image[..., :3].contiguous(), image[..., 3].contiguous()

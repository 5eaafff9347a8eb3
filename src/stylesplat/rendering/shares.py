"""Contributions between Gaussians and pixels: sums over the columns and rows of the weights W.

A render is `B + W c` (see `linear.py`). Column sums are the contributions of each Gaussian to a set
of pixels, by which label maps vote for Gaussians; products with W let Gaussians vote for pixels.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_array, csr_array
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.rendering.render import rasterize, render
from stylesplat.rendering.visibility import LARGE, pixel_bounds
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, ids_of
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import IDENTITY_SIZE, Splats

AT_ONCE = IDENTITY_SIZE  # columns in one pass, whatever they are: kernels are compiled for these
NOBODY = -1  # no label
TALL = 0.25  # of a view, beyond which a label counts as tall
COVERED = 0.5  # the opaque share from which a pixel or a feature is an object's
TINY_COVERAGE = 1e-6  # of a pixel, below which an average over it is undefined
PRIOR = 0.02  # votes of background that every Gaussian has: hidden ones have hardly more


def without_looks(splats: Splats) -> Splats:
    """The splats without higher bands and identities, which is enough for weights."""
    return replace(splats, shN=splats.shN[:, :0], identities=None, confidence=None)


def contributed(
    splats: Splats,
    camera: Cameras,
    wanted: Float[Tensor, "H W L"],
) -> Float[Tensor, "N L"]:
    """The contribution of each Gaussian to some sets of pixels of a view.

    `wanted` is how much each pixel counts in each set. A render is linear in what Gaussians carry,
    so this is the gradient of its sums. With `AT_ONCE` sets no kernel is compiled anew.
    """
    carried = splats.means.new_zeros(len(splats), wanted.shape[-1]).requires_grad_()
    with torch.enable_grad():
        image, _, _ = rasterize(
            splats, camera, features=carried, features_move_geometry=False, sh_degree=0
        )
        (weights,) = torch.autograd.grad(image[0, ..., 3:], carried, wanted)
    return weights


@torch.no_grad()
def label_votes(
    splats: Splats,
    cameras: Cameras,
    label_maps: Iterable[tuple[int, Int[Tensor, "H W"]]],
) -> tuple[tuple[int, ...], csr_array]:
    """The contributions of each Gaussian to the pixels of each label, over some views.

    A Gaussian contributes to pixels of a few labels, however many there are: only these are kept.

    Args:
        splats: The scene.
        cameras: Views of it.
        label_maps: Rows of cameras, and the labels of their pixels, `NOBODY` for none.

    Returns:
        The ids that occur, background first, and the votes [N, K].
    """
    columns, total = {BACKGROUND: 0}, csr_array((len(splats), 1), dtype=np.float32)
    for row, labels in label_maps:
        present = sorted(ids_of(labels) - {NOBODY})
        if not present:
            continue
        for id in present:
            columns.setdefault(id, len(columns))
        total.resize((len(splats), len(columns)))
        more = _votes_of_view(splats, cameras[row], labels, {id: columns[id] for id in present})
        more.resize((len(splats), len(columns)))
        total = csr_array(total + more)
    ids = tuple(sorted(columns))
    return ids, total[:, [columns[id] for id in ids]]


def _votes_of_view(
    splats: Splats, camera: Cameras, labels: Int[Tensor, "H W"], columns: Mapping[int, int]
) -> csr_array:
    """The votes of one view, in columns by the label ids that it has, which ascend."""
    gaussians, found, values = [], [], []
    for some, rows in _some_labels(splats, camera, labels, labels.new_tensor([*columns])):
        wanted = labels[..., None] == pad(some, (0, AT_ONCE - len(some)), value=NOBODY)
        within = splats if rows is None else splats[rows]
        weights = contributed(within, camera, wanted.to(splats.means))[:, : len(some)]
        row, number = weights.nonzero(as_tuple=True)
        gaussians.append((row if rows is None else rows[row]).cpu().numpy())
        found.append(np.array([columns[id] for id in some.tolist()])[number.cpu().numpy()])
        values.append(weights[row, number].cpu().numpy())
    places = np.concatenate(gaussians), np.concatenate(found)
    shape = len(splats), max(columns.values()) + 1
    votes = csr_array((np.concatenate(values), places), shape=shape)
    votes.sort_indices()  # sums of sorted ones need no sorting
    return votes


def _some_labels(
    splats: Splats, camera: Cameras, labels: Int[Tensor, "H W"], ids: Int[Tensor, " K"]
) -> Iterator[tuple[Int[Tensor, " L"], Int[Tensor, " M"] | None]]:
    """As many label ids as one pass takes, and the Gaussians that may reach their pixels.

    Of more than one pass on the CPU each has labels that lie at one height of the view, and the
    Gaussians there: many small labels take not much longer than few large ones. None is for all.
    """
    if len(ids) <= AT_ONCE or splats.device.type != "cpu":
        yield from ((some, None) for some in ids.split(AT_ONCE))
        return
    height, where = len(labels), torch.searchsorted(ids, labels)
    y = torch.arange(height)[:, None].expand_as(labels).flatten()
    tops, lasts = (
        y.new_zeros(len(ids)).scatter_reduce(0, where.flatten(), y, how, include_self=False)
        for how in ("amin", "amax")
    )
    tall = lasts - tops > TALL * height  # in passes of their own, so that the others' are low
    low, high = pixel_bounds(splats, camera)
    for some in torch.where(tall, -1, tops).argsort(stable=True).split(AT_ONCE):
        top, last = tops[some].min(), lasts[some].max()
        reaching = (low < high).all(dim=1) & (low[:, 1] <= last) & (high[:, 1] > top)
        yield ids[some], reaching.nonzero()[:, 0]


def scaled_rows(votes: csr_array, factors: Float[np.ndarray, " N"]) -> csr_array:
    """Votes with a factor on those of each Gaussian."""
    scaled = votes.copy()
    scaled.data *= np.repeat(factors, np.diff(votes.indptr))
    return scaled


@torch.no_grad()
def render_shares(
    splats: Splats,
    camera: Cameras,
    shares: Float[Tensor, "N K"],
) -> Float[Tensor, "H W K"]:
    """The render of numbers per Gaussian, such as shares of labels."""
    images = []
    for some in shares.split(AT_ONCE, dim=1):
        padded = pad(some, (0, AT_ONCE - some.shape[1]))
        image, _ = render(splats, camera, features=padded, sh_degree=0)
        images.append(image[..., 3 : 3 + some.shape[1]])
    return torch.cat(images, dim=-1)


@torch.no_grad()
def largest_shown(
    splats: Splats, camera: Cameras, shares: csr_array
) -> tuple[Float[Tensor, "H W"], Int[Tensor, "H W"]]:
    """The largest number of `render_shares` in each pixel, and its column; for shares [N, K]."""
    width, height = camera.size
    most, column = torch.full((height, width), -torch.inf), torch.zeros(height, width).long()
    by_column = csc_array(shares)
    for columns in torch.arange(len(by_column.indptr) - 1).split(AT_ONCE):
        some = torch.from_numpy(by_column[:, columns.numpy()].toarray()).to(splats.means)
        values, places = render_shares(splats, camera, some).cpu().max(dim=-1)
        column = torch.where(values > most, columns[places], column)
        most = torch.maximum(values, most)
    return most, column


@torch.no_grad()
def coverage(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> Float[Tensor, "H W"]:
    """The opaque share of an object in each pixel of one camera; others may hide it."""
    features = picked.to(splats.means)[:, None]
    pixels = None
    if len(splats) >= LARGE:  # skip the others where it cannot be visible
        alone = without_looks(splats)[picked.nonzero()[:, 0]]
        pixels = render(alone, camera, sh_degree=0)[1][..., 0] > 0
    image, _ = render(splats, camera, features=features, sh_degree=0, pixels=pixels)
    return image[:, :, 3]


def full_coverage(splats: Splats, camera: Cameras) -> Float[Tensor, "H W"]:
    """The opaque share of all Gaussians in each pixel of one camera."""
    return coverage(splats, camera, torch.ones_like(splats.opacities, dtype=torch.bool))


@torch.no_grad()
def colors_and_coverage(
    splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W 1"]]:
    """The image of one camera, and the picked Gaussians' share of every pixel."""
    features = picked.to(splats.means)[:, None]
    image, _ = render(splats, camera, features=features)
    return image[..., :3], image[..., 3:]


@torch.no_grad()
def expected_depth(
    splats: Splats, camera: Cameras
) -> tuple[Float[Tensor, "H W"], Float[Tensor, "H W"]]:
    """The expected depth of each pixel of one camera, and its coverage.

    The depth is undefined where hardly anything is visible, and 0 where nothing is.
    """
    depths = depths_of(splats.means, camera)[:, None]
    image, alphas = render(splats, camera, features=depths, sh_degree=0)
    alphas = alphas[..., 0]
    return image[..., 3] / alphas.clamp(min=TINY_COVERAGE), alphas

"""What Gaussians and pixels are to each other: sums over the columns and rows of the weights W.

A render is `B + W c` (see `linear.py`). Column sums say how much each Gaussian shows in a set of
pixels, and so how label maps vote for Gaussians; products with W how Gaussians vote for pixels.
"""

from collections.abc import Iterable
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.rendering.one_view import render
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.seen import LARGE
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import IDENTITY_SIZE, Splats

AT_ONCE = IDENTITY_SIZE  # columns in one pass, whatever they are: kernels are compiled for these
NOBODY = -1  # no label
COVERED = 0.5  # the opaque share from which a pixel or a feature is an object's
TINY_COVERAGE = 1e-6  # of a pixel, below which an average over it is undefined
PRIOR = 0.02  # pixels of background that every Gaussian has seen: hidden ones have hardly more


def without_looks(splats: Splats) -> Splats:
    """The same without higher bands and identities: quicker to draw where weights are all."""
    return replace(splats, shN=splats.shN[:, :0], identities=None, confidence=None)


def contributed(
    splats: Splats,
    camera: Cameras,
    wanted: Float[Tensor, "H W L"],
) -> Float[Tensor, "N L"]:
    """What each Gaussian contributes to some sets of pixels of a view, summed over each.

    A render is linear in what Gaussians carry, so this is the gradient of its sums. With as many
    sets each time, as many as identities have numbers, no kernel is compiled anew.

    Args:
        splats: The scene.
        camera: One camera.
        wanted: How much each pixel counts in each set.
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
) -> tuple[tuple[int, ...], Float[Tensor, "N K"]]:
    """How many pixels of each label a Gaussian makes up, over some views.

    Args:
        splats: The scene.
        cameras: Views of it.
        label_maps: Rows of cameras, and the labels of their pixels.

    Returns:
        The ids that occur, background first, and the votes.
    """
    found: dict[int, Tensor] = {BACKGROUND: splats.means.new_zeros(len(splats))}
    for row, labels in label_maps:
        present = labels.unique().tolist()
        for start in range(0, len(present), AT_ONCE):
            some = present[start : start + AT_ONCE]
            columns = labels.new_full((AT_ONCE,), NOBODY)
            columns[: len(some)] = torch.tensor(some)
            wanted = (labels[..., None] == columns).to(splats.means)
            weights = contributed(splats, cameras[row], wanted)
            for column, id in enumerate(some):
                found[id] = found.get(id, 0) + weights[:, column]
    ids = tuple(sorted(found))
    return ids, torch.stack([found[id] for id in ids], dim=1)


@torch.no_grad()
def render_shares(
    splats: Splats,
    camera: Cameras,
    shares: Float[Tensor, "N K"],
) -> Float[Tensor, "H W K"]:
    """What one camera sees of numbers that Gaussians carry, such as shares of labels."""
    images = []
    for some in shares.split(AT_ONCE, dim=1):
        padded = torch.nn.functional.pad(some, (0, AT_ONCE - some.shape[1]))
        image, _ = render(splats, camera, features=padded, sh_degree=0)
        images.append(image[..., 3 : 3 + some.shape[1]])
    return torch.cat(images, dim=-1)


@torch.no_grad()
def coverage(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> Float[Tensor, "H W"]:
    """The opaque share of an object in each pixel of one camera, what hides it in front."""
    features = picked.to(splats.means)[:, None]
    pixels = None
    if len(splats) >= LARGE:  # others need not be looked at where it cannot show
        alone = without_looks(splats)[picked.nonzero()[:, 0]]
        pixels = render(alone, camera, sh_degree=0)[1][..., 0] > 0
    image, _ = render(splats, camera, features=features, sh_degree=0, pixels=pixels)
    return image[:, :, 3]


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
    """The depth of what shows in each pixel of one camera, and how much is covered.

    Where hardly anything shows, the depth means nothing; where nothing does, it is 0.
    """
    depths = depths_of(splats.means, camera)[:, None]
    image, alphas = render(splats, camera, features=depths, sh_degree=0)
    alphas = alphas[..., 0]
    return image[..., 3] / alphas.clamp(min=TINY_COVERAGE), alphas

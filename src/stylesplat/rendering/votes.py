"""How label maps and Gaussians vote for each other: pixels for Gaussians, and the other way."""

from collections.abc import Iterable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.rendering.contributed import contributed
from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.splats import IDENTITY_SIZE, Splats

AT_ONCE = IDENTITY_SIZE  # columns in one pass, whatever they are: kernels are compiled for these
NOBODY = -1  # no label
PRIOR = 0.02  # pixels of background that every Gaussian has seen: hidden ones have hardly more


@torch.no_grad()
def label_votes(
    splats: Splats,
    cameras: Cameras,
    label_maps: Iterable[tuple[int, Int[Tensor, "H W"]]],
    *,
    backend: Backend = "auto",
) -> tuple[tuple[int, ...], Float[Tensor, "N K"]]:
    """How many pixels of each label a Gaussian makes up, over some views.

    Args:
        splats: The scene.
        cameras: Views of it.
        label_maps: Rows of cameras, and the labels of their pixels.
        backend: Of the rasteriser.

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
            weights = contributed(splats, cameras[row], wanted, backend=backend)
            for column, id in enumerate(some):
                found[id] = found.get(id, 0) + weights[:, column]
    ids = tuple(sorted(found))
    return ids, torch.stack([found[id] for id in ids], dim=1)


@torch.no_grad()
def render_shares(
    splats: Splats,
    camera: Cameras,
    shares: Float[Tensor, "N K"],
    *,
    backend: Backend = "auto",
) -> Float[Tensor, "H W K"]:
    """What one camera sees of numbers that Gaussians carry, such as shares of labels."""
    images = []
    for some in shares.split(AT_ONCE, dim=1):
        padded = torch.nn.functional.pad(some, (0, AT_ONCE - some.shape[1]))
        image, _, _ = rasterize(splats, camera, features=padded, sh_degree=0, backend=backend)
        images.append(image[0, ..., 3 : 3 + some.shape[1]])
    return torch.cat(images, dim=-1)

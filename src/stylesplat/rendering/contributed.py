"""How much Gaussians show in sets of pixels: the column sums of the weights, as a gradient."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats


def contributed(
    splats: Splats,
    camera: Cameras,
    wanted: Float[Tensor, "H W L"],
    *,
    backend: Backend = "auto",
) -> Float[Tensor, "N L"]:
    """What each Gaussian contributes to some sets of pixels of a view, summed over each.

    A render is linear in what Gaussians carry, so this is the gradient of its sums. With as many
    sets each time, as many as identities have numbers, no kernel is compiled anew.

    Args:
        splats: The scene.
        camera: One camera.
        wanted: How much each pixel counts in each set.
        backend: Of the rasteriser.
    """
    carried = splats.means.new_zeros(len(splats), wanted.shape[-1]).requires_grad_()
    with torch.enable_grad():
        image, _, _ = rasterize(
            *(splats, camera),
            features=carried,
            features_move_geometry=False,
            sh_degree=0,
            backend=backend,
        )
        (weights,) = torch.autograd.grad(image[0, ..., 3:], carried, wanted)
    return weights

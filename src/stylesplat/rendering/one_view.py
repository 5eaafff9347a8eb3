"""What one camera sees, without gradients: in the memory of what is seen."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.rendering.rasterize import beside, over_background, rasterize
from stylesplat.rendering.seen import PART, seen, unhidden
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

MANY = 1 << 21  # seen Gaussians, from which features are gathered of those alone that show


@torch.no_grad()
def render(
    splats: Splats,
    camera: Cameras,
    *,
    features: Float[Tensor, "N F"] | None = None,
    background: Float[Tensor, " 3"] | None = None,
    sh_degree: int | None = None,
    pixels: Bool[Tensor, "H W"] | None = None,
) -> tuple[Float[Tensor, "H W D"], Float[Tensor, "H W 1"]]:
    """Render splats from one camera, without gradients.

    Args:
        splats: The Gaussians.
        camera: One camera.
        features: More channels to composite in the same pass; they follow the three colours.
        background: RGB behind everything; black by default. Features have 0 behind them.
        sh_degree: How many bands of colour to use; all of them by default.
        pixels: Those that are wanted; others need not be right. All of them by default.

    Returns:
        The image and the coverage, as `rasterize` has them.
    """
    rest = {"features": features, "background": background, "sh_degree": sh_degree}
    if splats.device.type != "cpu":
        images, alphas, _ = rasterize(splats, camera, **rest)
        return images[0], alphas[0]
    from stylesplat.rendering import cpu

    near = seen(splats, camera, pixels)
    if features is not None and len(near.rows) > MANY:
        near = unhidden(near, camera)
    colors = colors_of(splats, near.rows, beside(splats, camera).positions, sh_degree, features)
    drawing = cpu.draw(near.projected, near.opacities, cpu.padded(colors), camera.size)
    image, alphas = drawing.image[..., : colors.shape[1]], drawing.alphas
    return over_background(image, alphas, background), alphas


def colors_of(
    splats: Splats,
    rows: Int[Tensor, " M"],
    origin: Float[Tensor, "1 3"],
    sh_degree: int | None = None,
    features: Float[Tensor, "N F"] | None = None,
) -> Float[Tensor, "M D"]:
    """Colours of some Gaussians, on the CPU, as seen from a point; their features follow."""
    from stylesplat.rendering import cpu

    degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
    tensors = splats.means, splats.sh0, splats.shN[:, : (degree + 1) ** 2 - 1]
    parts = []
    for some in rows.split(PART):
        means, *sh = (each.index_select(0, some) for each in tensors)
        own = cpu.spherical_harmonics(degree, means - origin, *sh)
        if features is not None:
            own = torch.cat([own, features.index_select(0, some)], dim=1)
        parts.append(own)
    return parts[0] if len(parts) == 1 else torch.cat(parts)

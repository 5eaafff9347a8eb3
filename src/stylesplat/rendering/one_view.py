"""What one camera sees, without gradients: in the memory of what is seen."""

import torch
from jaxtyping import Float, Int
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
) -> tuple[Float[Tensor, "H W D"], Float[Tensor, "H W 1"]]:
    """Render splats from one camera, without gradients.

    Args:
        splats: The Gaussians.
        camera: One camera.
        features: More channels to composite in the same pass; they follow the three colours.
        background: RGB behind everything; black by default. Features have 0 behind them.
        sh_degree: How many bands of colour to use; all of them by default.

    Returns:
        The image and the coverage, as `rasterize` has them.
    """
    rest = {"features": features, "background": background, "sh_degree": sh_degree}
    if splats.device.type != "cpu":
        images, alphas, _ = rasterize(splats, camera, **rest)
        return images[0], alphas[0]
    from stylesplat.rendering import cpu

    near = seen(splats, camera)
    if features is not None and len(near.rows) > MANY:
        near = unhidden(near, camera)
    colors = _channels(splats, near.rows, beside(splats, camera).positions, features, sh_degree)
    drawing = cpu.draw(near.projected, near.opacities, cpu.padded(colors), camera.size)
    image, alphas = drawing.image[..., : colors.shape[1]], drawing.alphas
    return over_background(image, alphas, background), alphas


def _channels(
    splats: Splats,
    rows: Int[Tensor, " M"],
    origin: Float[Tensor, "1 3"],
    features: Float[Tensor, "N F"] | None,
    sh_degree: int | None,
) -> Float[Tensor, "M D"]:
    """Colours of some Gaussians as seen from a point, and their features."""
    from stylesplat.rendering import cpu

    degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
    higher = splats.shN[:, : (degree + 1) ** 2 - 1]
    parts = []
    for some in rows.split(PART):
        dirs, sh = splats.means[some] - origin, (splats.sh0[some], higher[some])
        colors = cpu.spherical_harmonics(degree, dirs, *sh)
        parts.append(colors if features is None else torch.cat([colors, features[some]], dim=1))
    return torch.cat(parts)

"""Where a viewer's camera stands at the start."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of
from stylesplat.scene.framing import Sight, distances, focal_at
from stylesplat.scene.poses import up_vector
from stylesplat.scene.splats import Splats

UP = torch.tensor([0.0, 0.0, 1.0]).double()  # where nobody knows it
WINDOW = (1600, 1200)  # pixels, or wider: what all content fits into at the start
FOCAL = 1450.0  # pixels: 45 degrees from the top to the bottom
MIN_DISTANCE = 0.1  # to what the first camera looks at, should the middle lie behind it


@dataclass(frozen=True)
class FirstView:
    """A camera that looks at a place, upright."""

    position: Float[Tensor, "3"]
    """Where it stands."""
    target: Float[Tensor, "3"]
    """What it turns around."""
    up: Float[Tensor, "3"]
    """The direction that is up, of length 1."""
    slopes: tuple[float, float]
    """Width and height of what it shows at distance 1."""


def first_view(splats: Splats, cameras: Cameras | None) -> FirstView:
    """At the first photo's camera, or from where all content is in sight.

    Args:
        splats: At least one Gaussian.
        cameras: Where the photos were taken; without them up is a guess.
    """
    content = content_of(splats)
    middle = content.extent.centre
    if cameras is not None:
        position, forward = cameras.positions[0].double(), cameras.viewmats[0, 2, :3].double()
        target = position + ((middle - position) @ forward).clamp(min=MIN_DISTANCE) * forward
        width, height = cameras.sizes[0].tolist()
        slopes = width / float(cameras.Ks[0, 0, 0]), height / float(cameras.Ks[0, 1, 1])
        return FirstView(position, target, up_vector(cameras), slopes)
    outward = torch.nn.functional.normalize(torch.ones(3).double(), dim=0)
    sight = Sight(middle, outward, UP, WINDOW)
    distance = distances(content, sight, FOCAL).best
    focal = focal_at(content.outline, sight, distance)
    slopes = WINDOW[0] / focal, WINDOW[1] / focal
    return FirstView(middle + distance * outward, middle, UP, slopes)

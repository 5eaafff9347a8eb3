"""What the identities say: the object of every Gaussian and of every pixel."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering.render import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.splats import Classifier, Splats

MIN_COVERAGE = 0.5  # of a pixel, below which it shows mostly what lies behind all Gaussians

UNLABELLED = (
    "Train from a capture with label maps, or import with one (`object_mask/` or --masks); of a "
    "splat without photos `stylesplat mask SCENE --box NAME=VIEW:x0,y0,x1,y1` makes some; or pick "
    "by shape, with --box3d or --sphere."
)


def require_identities(splats: Splats) -> tuple[Float[Tensor, "N 16"], Classifier]:
    """The identities and their classifier.

    Raises:
        StyleSplatError: If the splats were made without label maps.
    """
    if splats.identities is None or splats.classifier is None:
        raise StyleSplatError(
            f"These splats have no identities, so no objects are known. {UNLABELLED}"
        )
    return splats.identities, splats.classifier


def object_ids(splats: Splats) -> tuple[int, ...]:
    """The label ids that can be selected: all but background, in ascending order.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    _, classifier = require_identities(splats)
    return tuple(sorted(set(classifier.ids) - {BACKGROUND}))


@torch.no_grad()
def class_probabilities(splats: Splats) -> Float[Tensor, "N K"]:
    """How likely each Gaussian belongs to each class of the classifier (softmax).

    Of many Gaussians and classes see `Classifier.some_at_a_time`: this table would be too large.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    identities, classifier = require_identities(splats)
    return classifier.logits(identities).softmax(dim=-1)


@torch.no_grad()
def render_labels(splats: Splats, camera: Cameras) -> Int[Tensor, "H W"]:
    """The label map that one camera sees: the class of each pixel's composited identity.

    Args:
        splats: Gaussians with identities.
        camera: A single camera.

    Returns:
        Label ids, 0 where the Gaussians cover less than half of a pixel.

    Raises:
        StyleSplatError: If the splats have no identities.
    """
    identities, classifier = require_identities(splats)
    image, alphas = render(splats, camera, features=identities, sh_degree=0)
    labels = classifier.likeliest(image[..., 3:])
    return torch.where(alphas[..., 0] < MIN_COVERAGE, BACKGROUND, labels)

"""Decoding of identities: the object of every Gaussian and of every pixel."""

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
    "splat without photos `stylesplat mask SCENE --box NAME=VIEW:x0,y0,x1,y1` makes some; or "
    "select without labels, with --point, --box3d or --sphere."
)


def require_identities(splats: Splats) -> tuple[Float[Tensor, "N 16"], Classifier]:
    """The identities and their classifier; refuses splats without."""
    if splats.identities is None or splats.classifier is None:
        raise StyleSplatError(
            f"These splats have no identities, so no objects are known. {UNLABELLED}"
        )
    return splats.identities, splats.classifier


def object_ids(splats: Splats) -> tuple[int, ...]:
    """The label ids of all objects, in ascending order; refuses splats without identities."""
    _, classifier = require_identities(splats)
    return tuple(sorted(set(classifier.ids) - {BACKGROUND}))


@torch.no_grad()
def render_labels(splats: Splats, camera: Cameras) -> Int[Tensor, "H W"]:
    """The label map of one camera: the label id of each pixel's composited identity.

    A pixel is background where the Gaussians cover less than half of it.
    """
    identities, classifier = require_identities(splats)
    image, alphas = render(splats, camera, features=identities, sh_degree=0)
    labels = classifier.likeliest(image[..., 3:])
    return torch.where(alphas[..., 0] < MIN_COVERAGE, BACKGROUND, labels)

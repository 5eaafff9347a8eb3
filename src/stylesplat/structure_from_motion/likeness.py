"""Which photos look alike: as many of the largest features of one are found in the other."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize, pad

from stylesplat.progress import track
from stylesplat.structure_from_motion.workplace import Workplace

# After Wu, Towards Linear-Time Incremental Structure from Motion, 2013. With 128 features 97 of
# 100 of fox's pairs that look most alike do match; twice as many features change nothing
LARGEST = 128
MAX_RATIO = 0.8  # of the angles to the best and the second-best match, as COLMAP has it
DESCRIPTOR = 128  # numbers


def alike(place: Workplace) -> Int[Tensor, "P P"]:
    """How many of the largest features of two photos match, for each two.

    0 for a photo and itself, and where one has no features.
    """
    feats = torch.stack([_largest(place, file) for file in place.files])
    rows = [
        _matched(feats[row], feats)
        for row in track(range(len(feats)), "comparing photos", unit="photo")
    ]
    found = torch.stack(rows)
    found = found + found.T
    return found.fill_diagonal_(0)


def _largest(place: Workplace, file: str) -> Float[Tensor, "L 128"]:
    """The descriptors of a photo's largest features, of length 1; zeros follow if it has fewer."""
    with place.opened() as database:
        image = database.read_image_with_name(file)
        if image is None:  # COLMAP could not read it
            return torch.zeros(LARGEST, DESCRIPTOR)
        shapes = database.read_keypoints(image.image_id)
        descriptors = database.read_descriptors(image.image_id).data
    areas = np.abs(shapes[:, 2] * shapes[:, 5] - shapes[:, 3] * shapes[:, 4])
    order = np.argsort(-areas, kind="stable")[:LARGEST]
    feats = normalize(torch.from_numpy(descriptors[order].astype(np.float32)), dim=1)
    return pad(feats, (0, 0, 0, LARGEST - len(feats)))


def _matched(feats: Float[Tensor, "L 128"], others: Float[Tensor, "P L 128"]) -> Int[Tensor, " P"]:
    """How many of a photo's features have a clear match in each of the others."""
    cosines = torch.einsum("ad,pbd->pab", feats, others)
    best, where = cosines.max(dim=-1)
    second = cosines.scatter_(-1, where[..., None], -1.0).amax(dim=-1)
    clear = best.clamp(-1, 1).acos() < MAX_RATIO * second.clamp(-1, 1).acos()
    return (clear & (best > 0)).sum(dim=-1)

"""Objects of one photo found again in others by way of a splat, where no model can follow them."""

from collections.abc import Mapping, Sequence

import torch

from stylesplat.masks.models.associate import to_labels, to_masks
from stylesplat.rendering.shares import PRIOR, label_votes, largest_shown, scaled_rows
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND, Mask
from stylesplat.scene.splats import Splats

SURE = 0.3  # of a pixel, that an object must make up to be taken for what shows there


@torch.no_grad()
def follow_through(
    splats: Splats, cameras: Cameras, rows: Sequence[int], seeds: Mapping[int, Mask]
) -> list[dict[int, Mask]]:
    """From masks by id in the first photo to those in all of some photos.

    The masks are lifted onto the Gaussians that show there, and rendered into the others: what
    only the others show stays unmasked.

    Args:
        splats: A scene of the photos.
        cameras: Of all photos.
        rows: The photos.
        seeds: Masks that do not overlap.

    Returns:
        Masks by id for each photo; those of the first are the seeds.
    """
    if not seeds:
        return [{} for _ in rows]
    labels = to_labels(seeds, next(iter(seeds.values())).shape)
    ids, votes = label_votes(splats, cameras, [(rows[0], labels)])
    shares = scaled_rows(votes, 1 / (votes.sum(axis=1) + PRIOR))
    known, found = torch.tensor(ids), [dict(seeds)]
    for row in rows[1:]:
        certainty, column = largest_shown(splats, cameras[row], shares)
        found.append(to_masks(torch.where(certainty > SURE, known[column], BACKGROUND)))
    return found

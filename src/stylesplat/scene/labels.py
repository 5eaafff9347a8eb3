"""Label maps and masks."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Int, Shaped
from torch import Tensor

BACKGROUND = 0  # the label id that means 'no object'
FEW = 2**16  # ids below which counting them is faster than sorting the pixels
ALL = 0.999  # share of a pixel that counts as all of it, as sums are rounded
MAX_ID = 2**24 - 1  # what three bytes hold, as in RGB-coded label maps

Mask = Bool[Tensor, "H W"]
Labels = Int[Tensor, "H W"]
OwnLabels = Int[Tensor, "_ _"]  # one of several label maps, which may differ in size


def ids_of(labels: OwnLabels | None) -> set[int]:
    """The ids that occur in a label map, background included; none if there is no map."""
    if labels is None or labels.numel() == 0:
        return set()
    if 0 <= int(labels.min()) and int(labels.max()) < FEW:
        return {*labels.flatten().bincount().nonzero()[:, 0].tolist()}
    return {*labels.unique().tolist()}


def resize_labels(labels: Shaped[Tensor, "H W"], size: Sequence[int]) -> Shaped[Tensor, "h w"]:
    if tuple(labels.shape) == tuple(size):
        return labels
    y, x = (
        ((torch.arange(new) + 0.5) * old / new).long()
        for new, old in zip(size, labels.shape, strict=True)
    )
    return labels[y[:, None].to(labels.device), x.to(labels.device)]


def shrink_mask(mask: Bool[Tensor, "H W"], size: Sequence[int]) -> Bool[Tensor, "h w"]:
    """A smaller mask, true where all that a pixel covers is."""
    import cv2  # here, as commands without photos do not need it

    if tuple(mask.shape) == tuple(size):
        return mask
    levels = mask.cpu().to(torch.float32).numpy()
    return torch.from_numpy(cv2.resize(levels, size[::-1], interpolation=cv2.INTER_AREA) > ALL)

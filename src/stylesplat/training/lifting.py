"""Label maps onto any splats, in closed form: what contributes to a pixel takes its label."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import track
from stylesplat.rendering.weights import NOBODY, PRIOR, label_pixels
from stylesplat.scene.capture import BACKGROUND, MAX_ID, Capture
from stylesplat.scene.splats import IDENTITY_SIZE, Classifier, Splats

SHARPNESS = 12.0  # logits of a Gaussian that all pixels agree on; half of them leave 0.5
REPULSIONS = 200  # steps in which the codes of more than 16 classes move apart
DOUBT = 0.01  # probability of all other classes together, for a label that is known
LIFT_MANY = 2048  # classes beyond which they stay where chance put them


@torch.no_grad()
def lift(splats: Splats, capture: Capture, *, rows: Sequence[int] | None = None) -> Splats:
    """Give every Gaussian the labels of the pixels that it contributes to.

    A render is linear in what Gaussians carry, so how much each contributes to the pixels of a
    label is a gradient: one pass over the views, no training. All views together outvote the
    mistakes of each.

    Args:
        splats: The scene.
        capture: Posed label maps of it.
        rows: The views to use; all by default.

    Returns:
        The splats with identities and a classifier, as after training, and with `confidence`.

    Raises:
        StyleSplatError: If the capture has no label maps, or no Gaussian shows in them.
    """
    maps = _label_maps(capture, rows)
    ids, votes = label_pixels(splats, capture.cameras, maps)
    if not votes.nnz:
        raise StyleSplatError(
            "None of the Gaussians shows in the capture's label maps. Check that the splat and the "
            "cameras share a world frame."
        )
    codes, classifier = _decoder(ids)
    weight = votes.sum(axis=1)
    confidence = votes.max(axis=1).toarray() / np.maximum(weight, PRIOR)
    coded = votes @ codes.numpy() + PRIOR * codes[ids.index(BACKGROUND)].numpy()
    identities = coded / (weight + PRIOR)[:, None]
    return _with_identities(splats, classifier, *map(torch.from_numpy, (identities, confidence)))


@torch.no_grad()
def with_labels_of(splats: Splats, newer: Splats, renamed: Mapping[int, int]) -> Splats:
    """The labels of splats, and over them the labels of the same Gaussians in `newer`.

    `renamed` gives the new id of each newer label but the background. An earlier label of the same
    id is replaced.
    """
    assert splats.classifier is not None and newer.classifier is not None
    assert splats.identities is not None and newer.identities is not None
    ids = (BACKGROUND, *sorted({*splats.classifier.ids, *renamed.values()} - {BACKGROUND}))
    codes, classifier = _decoder(ids)
    kept = [BACKGROUND if id in renamed.values() else id for id in splats.classifier.ids]
    given = [({BACKGROUND: BACKGROUND} | {**renamed})[id] for id in newer.classifier.ids]
    of_kept, of_given = (codes[[ids.index(id) for id in some]] for some in (kept, given))
    nothing = newer.classifier.ids.index(BACKGROUND)
    of_given[nothing] = 0  # what the newer labels leave is as it was
    identities = torch.empty_like(splats.identities)
    left = identities.new_empty(len(splats))
    for rows, scores in newer.classifier.some_at_a_time(newer.identities):
        shares = scores.softmax(dim=-1)
        identities[rows], left[rows] = shares @ of_given.to(shares), shares[:, nothing]
    for rows, scores in splats.classifier.some_at_a_time(splats.identities):
        identities[rows] += left[rows, None] * (scores.softmax(dim=-1) @ of_kept.to(scores))
    confidence = newer.confidence
    if confidence is not None and splats.confidence is not None:
        confidence = torch.where(left > 0.5, splats.confidence, confidence)
    return _with_identities(splats, classifier, identities, confidence)


def _with_identities(
    splats: Splats,
    classifier: Classifier,
    identities: Float[Tensor, "N 16"],
    confidence: Float[Tensor, " N"] | None,
) -> Splats:
    found = replace(splats, identities=identities, classifier=classifier, confidence=confidence)
    return found.to(splats.device)


def _decoder(ids: tuple[int, ...]) -> tuple[Float[Tensor, "K 16"], Classifier]:
    """The codes of classes, and the classifier that decodes identities made of them.

    Its logits are larger where codes are close to each other, so that a Gaussian of one label alone
    is likely that label, however many there are.
    """
    codes = class_codes(len(ids))
    closest = float((codes @ codes.T).fill_diagonal_(-1).max())
    sharpness = max(SHARPNESS, math.log(len(ids) / DOUBT) / (1 - closest))
    return codes, Classifier(sharpness * codes, codes.new_zeros(len(ids)), ids)


@torch.no_grad()
def labelled(splats: Splats, labels: Int[Tensor, " N"]) -> Splats:
    """Give every Gaussian a known label id, 0 for the background, as if it had been lifted.

    Raises:
        StyleSplatError: If there are more or fewer labels than Gaussians, none but 0, negative
            ones, or too many different ones.
    """
    if len(labels) != len(splats):
        raise StyleSplatError(
            f"There are {len(labels):,} labels for {len(splats):,} Gaussians. Give one for each."
        )
    ids, classes = torch.cat([labels.new_zeros(1), labels.cpu()]).unique(return_inverse=True)
    if ids[0] < 0 or ids[-1] > MAX_ID or not 1 < len(ids) <= LIFT_MANY:
        raise StyleSplatError(
            f"There are {len(ids) - 1:,} objects in labels from {int(ids[0])} to {int(ids[-1])}. "
            f"Label 1 to {LIFT_MANY - 1:,} objects with 1 to {MAX_ID}, and all else with 0."
        )
    codes, classifier = _decoder(tuple(ids.tolist()))
    return _with_identities(splats, classifier, codes[classes[1:]], None)


def class_codes(count: int) -> Float[Tensor, "K 16"]:
    """Directions that tell classes apart: at right angles if there is room, else far apart."""
    if count <= IDENTITY_SIZE:
        return torch.eye(count, IDENTITY_SIZE)
    generator = torch.Generator().manual_seed(0)
    codes = torch.randn(count, IDENTITY_SIZE, generator=generator)
    codes = torch.nn.functional.normalize(codes, dim=1)
    if count > LIFT_MANY:
        return codes
    for _ in range(REPULSIONS):
        closeness = (codes @ codes.T).fill_diagonal_(-1)
        push = (8 * closeness).softmax(dim=1) @ codes
        codes = torch.nn.functional.normalize(codes - 0.1 * push, dim=1)
    return codes


def _label_maps(
    capture: Capture, rows: Sequence[int] | None
) -> Iterator[tuple[int, Int[Tensor, "H W"]]]:
    if capture.label_maps is None:
        raise StyleSplatError(
            "The capture has no label maps to lift. Put them into `object_mask/`, or name their "
            "folder with --masks."
        )
    for index in track(range(len(capture.cameras)) if rows is None else rows, "lifting labels"):
        labels = capture.label_maps[index]
        valid = capture.valid(index)
        if labels is not None:
            yield index, labels if valid is None else labels.int().where(valid, NOBODY)

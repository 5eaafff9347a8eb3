"""How close rendered label maps are to given ones."""

from collections.abc import Sequence
from typing import Any

import torch

from stylesplat.metrics.iou import object_iou
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, Labels
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import render_labels


def label_metrics(splats: Splats, capture: Capture, rows: Sequence[int]) -> dict[str, Any]:
    """Compare the rendered labels of some views with their label maps.

    Returns:
        `iou` and `boundary_iou` by label id, their means over the objects (`miou`,
        `boundary_miou`), and `unknown_ids`, those that the splats do not know. Empty without
        identities or label maps.
    """
    if splats.classifier is None:
        return {}
    known = torch.tensor(splats.classifier.ids)
    pairs: list[tuple[Labels, Labels]] = []
    unknown: set[int] = set()
    for row in rows:
        given = capture.labels(row)
        if given is not None:
            rendered = render_labels(splats, capture.cameras[row]).cpu()
            seen = torch.isin(given, known.to(given))
            unknown.update(given[~seen].unique().tolist())
            # What is background on either side counts for no object
            pairs.append((rendered.where(seen, BACKGROUND), given.where(seen, BACKGROUND)))
    if not pairs:
        return {}
    metrics: dict[str, Any] = {"unknown_ids": sorted(unknown)} if unknown else {}
    for prefix, boundary in (("", False), ("boundary_", True)):
        by_id = object_iou(pairs, boundary=boundary)
        metrics[f"{prefix}iou"] = by_id
        metrics[f"{prefix}miou"] = sum(by_id.values()) / max(len(by_id), 1)
    return metrics

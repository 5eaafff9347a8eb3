"""Label ids that are trained, as dense classes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Int, Integer
from torch import Tensor

from stylesplat.errors import some
from stylesplat.progress import say, track
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, ids_of


@dataclass(frozen=True)
class Shown:
    """Which label ids photos show."""

    trained: tuple[int, ...]
    """In the photos that are trained on, background first; none if these have no label maps."""
    held_out: Mapping[str, tuple[int, ...]]
    """By name of a held-out photo the ids that no trained one shows."""


def shown_ids(capture: Capture, rows: Sequence[int]) -> Shown:
    """Look at all label maps, one at a time.

    Args:
        capture: With label maps or without.
        rows: The photos that are trained on; the others are held out.
    """
    if capture.label_maps is None:
        return Shown((), {})
    found = {row: ids_of(capture.labels(row)) for row in track(range(len(capture)), "reading ids")}
    labelled = [found[row] for row in rows if found[row]]
    trained = tuple(sorted({BACKGROUND}.union(*labelled))) if labelled else ()
    known = {BACKGROUND, *trained}
    unseen = {
        capture.cameras.names[row]: tuple(sorted(ids - known))
        for row, ids in found.items()
        if row not in rows and not ids <= known
    }
    return Shown(trained, unseen)


def say_unseen(shown: Shown, names: Mapping[int, str]) -> None:
    """Tell the user in one line about objects that are not learned as no trained photo shows them.

    Args:
        shown: What photos show.
        names: What objects are called, by id.
    """
    if not shown.held_out:
        return
    ids = sorted(set().union(*shown.held_out.values()))
    objects = some([f"{id} ({names[id]})" if id in names else str(id) for id in ids])
    photos = some([*shown.held_out])
    say(
        f"Not learned, for only held-out photos show it: object {objects} in {photos}. "
        "`--test-every 0` trains on all photos, another value holds out others."
    )


def to_classes(labels: Int[Tensor, "H W"], ids: tuple[int, ...]) -> Integer[Tensor, "H W"]:
    """Places in `ids`, which are sorted and hold all labels, in the smallest type for them."""
    known = torch.tensor(ids, dtype=torch.int32)
    classes = torch.searchsorted(known, labels.int(), out_int32=True)
    return classes.to(class_type(len(ids)))


def class_type(count: int) -> torch.dtype:
    """The smallest type that so many classes fit into."""
    if count <= 2**8:
        return torch.uint8
    return torch.int16 if count <= 2**15 else torch.int32

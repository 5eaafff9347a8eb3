"""The verb `mask`: give a capture its label maps."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from jaxtyping import Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import OBJECT_MASK, load
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import resize_labels
from stylesplat.scene.lazy import Lazy


def mask(capture: Capture, *, folder: Path | str | None = None) -> Capture:
    """Attach label maps that were made with another tool.

    Args:
        capture: Photos that `load` read, at any size.
        folder: Holds one label map per photo, named like it; by default the capture's
            `object_mask/`.

    Returns:
        The capture with label maps of its photos' sizes, read on access.

    Raises:
        StyleSplatError: If there are no label maps, or they do not fit the photos.
    """
    if capture.path is None:
        raise StyleSplatError(
            "This capture was not read from a folder, so its label maps cannot be found. "
            "Read it with `stylesplat.load(FOLDER)`."
        )
    source = load(capture.path, masks=folder)
    if source.label_maps is None:
        raise StyleSplatError(
            f"There are no label maps in {capture.path}. Make pictures of ids (0 = background) "
            f"with any segmentation tool, name them like the photos, and put them into "
            f"{capture.path / OBJECT_MASK}."
        )

    def read(row: int) -> Int[Tensor, "H W"] | None:
        assert source.label_maps is not None
        labels = source.label_maps[source.cameras.index(capture.cameras.names[row])]
        return labels if labels is None else resize_labels(labels, capture.cameras[row].size[::-1])

    return replace(capture, label_maps=Lazy([partial(read, row) for row in range(len(capture))]))

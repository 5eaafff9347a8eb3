"""`mask`: give a capture its label maps."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxtyping import Int
from torch import Tensor

from stylesplat.drawing.preview import mask_preview
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import OBJECT_MASK, load, open_capture
from stylesplat.io.files import claim_directory, refuse_occupied
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import NAMES, write_label_map, write_names
from stylesplat.masks.foreign import foreign_label_maps
from stylesplat.progress import track
from stylesplat.scene.labels import BACKGROUND

PREVIEW = "preview.jpg"  # beside the label maps, which are PNGs


def import_masks(capture_path: Path, source: Path, *, overwrite: bool = False) -> dict[str, Any]:
    """Write masks of another program into a capture, as `object_mask/`.

    Returns:
        As `write_masks` does.

    Raises:
        StyleSplatError: If the masks are not of this capture, or there are label maps already.
    """
    refuse_masks(capture_path, overwrite=overwrite)
    found = foreign_label_maps(source, load(capture_path, masks=False).cameras.names)
    return write_masks(capture_path, found.maps, found.names, overwrite=overwrite)


def refuse_masks(capture_path: Path, *, overwrite: bool) -> None:
    """Check that label maps may be written, before the work that makes them.

    Raises:
        StyleSplatError: If there are some already, a file is in their place, or photos differ in
            their suffix only.
    """
    output = capture_path / OBJECT_MASK
    names = open_capture(capture_path, masks=False).cameras.names
    if len({Path(name).with_suffix("") for name in names}) < len(names):
        raise StyleSplatError(
            f"Some photos in {capture_path} differ in their suffix only, so their label maps would "
            "have one name. Rename them."
        )
    if output.is_file() or not overwrite:
        refuse_occupied(output, marker="")


def write_masks(
    capture_path: Path,
    maps: Mapping[str, Callable[[], Int[Tensor, "H W"]]],
    names: Mapping[int, str],
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Write label maps into a capture, with a picture of some; other files there stay.

    Args:
        capture_path: The capture's folder.
        maps: By photo what makes its label map.
        names: What objects are called, by id; others have none.
        overwrite: Whether label maps that are there may be replaced.

    Returns:
        `masks`: their folder; `preview`: a picture of some; `photos`: how many photos have one;
        `of`: how many there are; `ids`: the objects found; `names`: what they are called.

    Raises:
        StyleSplatError: If they do not fit their photos, or there are label maps already.
    """
    output, ids = capture_path / OBJECT_MASK, set[int]()
    with claim_directory(output, overwrite=overwrite, marker="") as folder:
        for name, read in track(maps.items(), "label maps", unit="photo"):
            labels = read()
            ids |= set(labels.unique().tolist())
            write_label_map(labels, (folder / name).with_suffix(".png"))
        ids -= {BACKGROUND}
        called = {id: name for id, name in names.items() if id in ids}
        write_names(called, folder)
        capture = load(capture_path, masks=folder)  # refuses those that do not fit their photos
        write_image(mask_preview(capture, called), folder / PREVIEW)
    _remove_stale(output, set(capture.cameras.names) - maps.keys(), named=bool(called))
    return {
        "masks": output,
        "preview": output / PREVIEW,
        "photos": len(maps),
        "of": len(capture.cameras),
        "ids": sorted(ids),
        "names": called,
    }


def _remove_stale(folder: Path, photos: Iterable[str], *, named: bool) -> None:
    """Take away what an earlier run said of photos and names of which this one says nothing."""
    stale = [(folder / name).with_suffix(".png") for name in photos]
    for path in [*stale, *([] if named else [folder / NAMES])]:
        path.unlink(missing_ok=True)

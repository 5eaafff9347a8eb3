"""`mask`: give a capture its label maps."""

from pathlib import Path
from typing import Any

from tqdm import tqdm

from stylesplat.io.files import claim_directory, refuse_occupied
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.load import OBJECT_MASK, load
from stylesplat.masks.foreign import foreign_label_maps
from stylesplat.selection.labels import BACKGROUND


def import_masks(capture_path: Path, source: Path, *, overwrite: bool = False) -> dict[str, Any]:
    """Write masks of another program into a capture, as `object_mask/`.

    Returns:
        `masks`: their folder; `photos`: how many photos have one; `of`: how many there are;
        `ids`: the objects found.

    Raises:
        StyleSplatError: If the masks are not of this capture, or there are label maps already.
    """
    output = capture_path / OBJECT_MASK
    if not overwrite:
        refuse_occupied(output, marker="")
    names = load(capture_path).cameras.names
    found = foreign_label_maps(source, names)
    ids: set[int] = set()
    with claim_directory(output, overwrite=overwrite, marker="") as folder:
        for name, read in tqdm(found.items(), desc="label maps", unit="photo"):
            labels = read()
            ids |= set(labels.unique().tolist())
            write_label_map(labels, (folder / name).with_suffix(".png"))
        load(capture_path, masks=folder)  # refuses those that do not fit their photos
    return {
        "masks": output,
        "photos": len(found),
        "of": len(names),
        "ids": sorted(ids - {BACKGROUND}),
    }

"""Masks of other programs as label maps: pictures of ids, binary masks by object, COCO's RLE."""

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import kind_of
from stylesplat.io.label_maps import (
    DrawnLabels,
    FoundMasks,
    find_masks,
    overlay_masks,
    sizes_differ,
)
from stylesplat.io.mask_names import match_masks, without_suffix
from stylesplat.masks.coco import decode_rle, read_coco, rle_size
from stylesplat.scene.labels import BACKGROUND, Labels, OwnLabels, ids_of


def import_label_maps(source: Path, names: Sequence[str]) -> FoundMasks:
    """Find the masks of photos in another program's output.

    It may be pictures of ids named like the photos, in any sub-folder (DEVA, Gaussian Grouping); a
    sub-folder per object with a binary mask per photo; or COCO JSON with RLE masks.

    Args:
        source: A folder, or a .json file.
        names: The photos' names.

    Raises:
        StyleSplatError: If there is nothing of these photos, or the masks contradict each other.
    """
    check_mask_source(source)
    is_coco = source.suffix.lower() == ".json"
    found = _import_coco(source, names) if is_coco else find_masks(source, names)
    if not found.maps:
        raise StyleSplatError(
            f"No mask in {source} belongs to a photo of this capture. Name them like the photos: "
            f"{without_suffix(names[0])}.png."
        )
    return found


def refuse_plain(maps: Iterable[OwnLabels | None], whose: str, remedy: str) -> None:
    """Refuse label maps that tell nothing apart; `whose` and `remedy` begin and end the message."""
    shown = set[int]()
    for labels in maps:
        shown |= ids_of(labels)
        if len(shown) > 1:
            return
    what = "nothing but background" if shown <= {BACKGROUND} else "one object in every pixel"
    raise StyleSplatError(f"{whose} show {what}. {remedy}")


def check_mask_source(source: Path) -> None:
    """Refuse what cannot be masks of another program, before the photos are read.

    Raises:
        StyleSplatError: If it is neither a folder nor a .json file, or a capture or a scene.
    """
    kind = kind_of(source)
    if kind in ("capture", "scene"):
        raise StyleSplatError(
            f"{source} is a {kind}, not a folder of masks. Give --from the folder that the masks "
            "are in."
        )
    if not (source.is_dir() or (source.is_file() and source.suffix.lower() == ".json")):
        raise StyleSplatError(f"There is no folder or .json file {source}. Check the path.")


def _import_coco(source: Path, names: Sequence[str]) -> FoundMasks:
    by_photo, titles = read_coco(source)

    def decode(layers: Sequence[tuple[int, Any]]) -> Labels:
        return overlay_masks((id, decode_rle(rle, source)) for id, rle in layers)

    maps = {}
    for file, photo in match_masks(by_photo, names).items():
        layers, what = by_photo[file], f"of {file} in {source}"
        sizes = sorted({rle_size(rle, source) for _, rle in layers})
        if len(sizes) > 1:
            raise sizes_differ(what, *sizes[:2])
        maps[photo] = DrawnLabels(size=sizes[0], read=partial(decode, layers), what=what)
    return FoundMasks(maps, titles)

"""Masks of other programs as label maps: pictures of ids, masks by object, run lengths of COCO."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import msgspec
import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import with_drawn_maps
from stylesplat.io.captures.lens import LENS_MAX_SIDE
from stylesplat.io.images import IMAGE_MAX_PIXELS
from stylesplat.io.json_yaml import JSON_MAX_BYTES, convert_checked, read_json_as
from stylesplat.io.kinds import kind_of
from stylesplat.io.label_maps import (
    DrawnLabels,
    FoundMasks,
    find_masks,
    overlay_masks,
    sizes_differ,
)
from stylesplat.io.mask_pictures import match_masks, without_suffix
from stylesplat.scene.capture import BACKGROUND, MAX_ID, Capture, Labels, Mask, OwnLabels, ids_of

IMPORT_REMEDY = "Export images, annotations and RLE masks."
MAX_BITS = 40  # of a run's letters; 8 letters of 5, more than MAX_PIXELS needs
MaskSide = Annotated[int, msgspec.Meta(ge=1, le=LENS_MAX_SIDE)]
Run = Annotated[int, msgspec.Meta(ge=0, le=IMAGE_MAX_PIXELS)]


class CocoImage(msgspec.Struct):
    id: int | str
    file_name: str


class CocoCategory(msgspec.Struct):
    id: int
    name: int | float | str


class CocoAnnotation(msgspec.Struct):
    image_id: int | str
    segmentation: Any  # checked when the mask is decoded: masks of other photos do not matter
    category_id: int | None = None
    track_id: int | None = None


class CocoFile(msgspec.Struct):
    images: list[CocoImage]
    annotations: list[CocoAnnotation]
    categories: list[CocoCategory] = []


class RunLengths(msgspec.Struct):
    """A mask of COCO's run lengths, plain or compressed: columns first, starting with zeros."""

    size: tuple[MaskSide, MaskSide]
    """Height and width."""
    counts: str | list[Run]


def read_coco(source: Path) -> tuple[dict[str, list[tuple[int, Any]]], dict[int, str]]:
    """Read the masks in a file; an object is a track, or else a category.

    Returns by photo's name without suffix the objects' ids and their run lengths, unchecked; and by
    id the names of categories.
    """
    # Some programs write ids as 3.0 or "3"
    content = read_json_as(source, CocoFile, IMPORT_REMEDY, most=JSON_MAX_BYTES, strict=False)
    files = {
        image.id: PurePosixPath(image.file_name).with_suffix("").as_posix()
        for image in content.images
    }
    kinds = {kind.id: str(kind.name) for kind in content.categories}
    tracked = any(each.track_id is not None for each in content.annotations)
    names: dict[int, str] = {}
    found: dict[str, list[tuple[int, Any]]] = {}
    for each in content.annotations:
        number = each.track_id if tracked else each.category_id
        fault = None
        if each.image_id not in files:
            fault = f"there is no image {each.image_id!r}"
        elif number is None:
            fault = f"an annotation has no {'track_id' if tracked else 'category_id'}"
        elif not 0 < number <= MAX_ID:
            fault = f"the id {number} is not within 1 to {MAX_ID}; 0 is background"
        if number is None or fault:
            raise StyleSplatError(
                f"Cannot read {source} as COCO annotations: {fault}. {IMPORT_REMEDY}"
            )
        if not tracked and number in kinds:
            names[number] = kinds[number]
        found.setdefault(files[each.image_id], []).append((number, each.segmentation))
    return found, names


def decode_rle(rle: Any, source: Path) -> Mask:
    checked = _run_lengths(rle, source)
    height, width = checked.size
    runs = _unpack(checked.counts) if isinstance(checked.counts, str) else checked.counts
    # Python's integers do not wrap; NumPy's sum would, and np.repeat write out of bounds
    fits = height * width <= IMAGE_MAX_PIXELS and sum(runs) == height * width
    if not fits or min(runs, default=0) < 0:
        raise StyleSplatError(
            f"Cannot read a mask in {source}: its runs do not hold the pixels of {height}x{width}, "
            "or no photo is as large. Export the masks again."
        )
    values = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return torch.from_numpy(np.ascontiguousarray(values.reshape(width, height).T))


def _run_lengths(rle: Any, source: Path) -> RunLengths:
    what, remedy = f"Cannot read a mask in {source}", "Polygons are not understood: export RLE."
    return convert_checked(rle, RunLengths, what, remedy)


def _unpack(text: str) -> list[int]:
    """Run lengths from COCO's string: groups of 5 bits, and differences to the last but one."""
    value = shift = 0
    runs: list[int] = []
    for letter in text:
        group = ord(letter) - 48
        value |= (group & 0x1F) << shift
        shift += 5
        if shift > MAX_BITS:  # a damaged string: numbers of any length would be slow
            return []
        if not group & 0x20:
            if group & 0x10:  # negative
                value -= 1 << shift
            runs.append(value + runs[-2] if len(runs) > 2 else value)
            value = shift = 0
    return runs


@dataclass(frozen=True, eq=False)
class FromFiles:
    """Label maps of another program."""

    source: Path

    def __post_init__(self) -> None:
        check_mask_source(self.source)

    def mask(self, capture: Capture, device: str) -> Capture:
        """Give the photos the label maps, which have their names."""
        found = import_label_maps(self.source, capture.cameras.names)
        maps = (drawn.read() for drawn in found.maps.values())
        refuse_plain(maps, f"The masks in {self.source}", "Make them anew.")
        return with_drawn_maps(capture, found)


def import_label_maps(source: Path, names: Sequence[str]) -> FoundMasks:
    """Find the masks of photos in another program's output.

    It may be pictures of ids named like the photos, in any sub-folder (DEVA, Gaussian Grouping); a
    sub-folder per object with a binary mask per photo; or COCO JSON with RLE masks. Raises a
    StyleSplatError if there is nothing of these photos, or the masks contradict each other.
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
    """Refuse what cannot be masks of another program, before the photos are read."""
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
        shapes = {_run_lengths(rle, source).size for _, rle in layers}
        sizes = sorted((width, height) for height, width in shapes)
        if len(sizes) > 1:
            raise sizes_differ(what, *sizes[:2])
        maps[photo] = DrawnLabels(size=sizes[0], read=partial(decode, layers), what=what)
    return FoundMasks(maps, titles)

"""Masks of other programs, as label maps: pictures of ids, binary masks by object, COCO's RLE."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import read_json
from stylesplat.io.label_maps import DrawnLabels, read_label_map
from stylesplat.masks.photo_names import match_photos, photo_key
from stylesplat.scene.labels import MAX_ID, Labels, Mask

MAX_PIXELS = 2**28  # of a mask: more is a mistake, and would fill the memory
BAD_RLE = (KeyError, TypeError, ValueError, OverflowError)  # what damaged run lengths raise


@dataclass(frozen=True)
class Found:
    """Masks of photos among another program's output."""

    maps: dict[str, DrawnLabels]
    """By photo its label map, read on access; photos without one are left out."""
    names: dict[int, str] = field(default_factory=dict)
    """What objects are called, by id, where that is known."""


def foreign_label_maps(source: Path, names: Sequence[str]) -> Found:
    """Find the masks of photos among another program's output.

    Understood are pictures of ids named like the photos, in any sub-folder (DEVA, Gaussian
    Grouping); a sub-folder per object with a binary mask per photo; and COCO JSON with RLE masks.

    Args:
        source: A folder, or a .json file.
        names: The photos' names.

    Raises:
        StyleSplatError: If there is nothing of these photos, or the masks contradict each other.
    """
    if source.suffix.lower() == ".json":
        found = _coco(source, names)
    elif source.is_dir():
        found = _by_object(source, names) or _by_photo(source, names)
    else:
        raise StyleSplatError(f"There is no folder or .json file {source}. Check --from.")
    if not found.maps:
        raise StyleSplatError(
            f"No mask in {source} belongs to a photo of this capture. Name them like the photos: "
            f"{photo_key(names[0])}.png."
        )
    return found


def _by_photo(source: Path, names: Sequence[str]) -> Found:
    """Pictures of ids, wherever they lie."""
    files = _pictures(source)
    matches = match_photos(files, names)
    return Found({photo: DrawnLabels.on_disk(files[key]) for key, photo in matches.items()})


def _by_object(source: Path, names: Sequence[str]) -> Found | None:
    """A sub-folder for each object, the masks in it named like the photos."""
    folders = sorted(path for path in source.iterdir() if path.is_dir())
    tops = {PurePosixPath(name).parts[0] for name in names if "/" in name}
    if any(folder.name in tops for folder in folders):
        return None  # the folders of the photos
    masks = {folder: _named_like(names, folder) for folder in folders}
    objects = {folder: files for folder, files in masks.items() if files}
    if not objects or not all(map(_is_binary, _some(objects))):
        return None
    called = _numbers([folder.name for folder in objects])
    found: dict[str, list[tuple[int, Path]]] = {}
    for number, files in zip(called, objects.values(), strict=True):
        for photo, path in files.items():
            found.setdefault(photo, []).append((number, path))
    titles = {number: name for number, name in called.items() if not name.isdecimal()}
    return Found({photo: _stack(layers) for photo, layers in found.items()}, titles)


def _pictures(folder: Path) -> dict[str, Path]:
    """The pictures in a folder and below, by their path in it, without suffix."""
    paths = sorted(folder.rglob("*.png"))
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in paths}


def _named_like(names: Sequence[str], folder: Path) -> dict[str, Path]:
    """The pictures in a folder by photo: those with a photo's path or, without folder, name."""
    paths = {photo_key(name) for name in names}
    own = {key: p for key, p in _pictures(folder).items() if key in paths or "/" not in key}
    return {photo: own[key] for key, photo in match_photos(own, names).items()}


def _some(objects: Mapping[Path, Mapping[str, Path]]) -> Iterator[Path]:
    for files in objects.values():
        yield from list(files.values())[:3]


def _numbers(folders: Sequence[str]) -> dict[int, str]:
    """The folders by the ids that they are named by, or by their places in the order of names."""
    numbers = {int(name): name for name in folders if name.isdecimal()}
    if len(numbers) == len(folders) and all(0 < number <= MAX_ID for number in numbers):
        return numbers
    return dict(enumerate(folders, start=1))


def _is_binary(path: Path) -> bool:
    return len(read_label_map(path).unique()) <= 2


def _stack(layers: Sequence[tuple[int, Path]]) -> DrawnLabels:
    first = DrawnLabels.on_disk(layers[0][1])
    return replace(first, read=partial(_stacked, layers))


def _stacked(layers: Sequence[tuple[int, Path]]) -> Labels:
    """One label map of binary masks; smaller objects lie over larger ones."""
    masks = [(number, read_label_map(path) != 0) for number, path in layers]
    return overlaid(masks)


def overlaid(masks: Sequence[tuple[int, Mask]]) -> Labels:
    """A label map of masks by id; where they overlap the smaller one shows."""
    labels = torch.zeros(masks[0][1].shape, dtype=torch.int64)
    for number, mask in sorted(masks, key=lambda each: -int(each[1].sum())):
        if mask.shape != labels.shape:
            raise StyleSplatError(
                f"The masks of a photo differ in size: {list(mask.shape)} and "
                f"{list(labels.shape)}. Export them at the photo's size."
            )
        labels[mask] = number
    return labels


def _coco(source: Path, names: Sequence[str]) -> Found:
    """Annotations with RLE masks; an object is a track, or else a category."""
    content = read_json(source)
    try:
        files = {image["id"]: photo_key(image["file_name"]) for image in content["images"]}
        kinds = {kind["id"]: str(kind["name"]) for kind in content.get("categories", [])}
        tracked = any("track_id" in each for each in content["annotations"])
        titles: dict[int, str] = {}
        found: dict[str, list[tuple[int, Any]]] = {}
        for each in content["annotations"]:
            file = files[each["image_id"]]
            number = int(each["track_id"] if tracked else each["category_id"])
            if not tracked and number in kinds:
                titles[number] = kinds[number]
            if not 0 < number <= MAX_ID:
                raise ValueError(f"the id {number} is not within 1 to {MAX_ID}")
            found.setdefault(file, []).append((number, each["segmentation"]))
    except (KeyError, TypeError, ValueError) as error:
        raise StyleSplatError(
            f"Cannot read {source} as COCO annotations: {error!r}. Export them with images, "
            "annotations and RLE masks."
        ) from error
    matches = match_photos(found, names)
    maps = {
        photo: DrawnLabels(
            size=_rle_size(found[file][0][1], source),
            read=partial(_decoded, found[file], source),
            what=f"of {file} in {source}",
        )
        for file, photo in matches.items()
    }
    return Found(maps, titles)


def _decoded(layers: Sequence[tuple[int, Any]], source: Path) -> Labels:
    masks = [(number, decode_rle(rle, source)) for number, rle in layers]
    return overlaid(masks)


def decode_rle(rle: Any, source: Path) -> Mask:
    """A mask of COCO's run lengths, plain or compressed: columns first, starting with zeros.

    Raises:
        StyleSplatError: If they do not fill the mask.
    """
    width, height = _rle_size(rle, source)
    try:
        counts = rle["counts"]
        runs = np.array(_unpack(counts) if isinstance(counts, str) else counts, np.int64)
        if height * width != runs.sum() or runs.min(initial=0) < 0:
            raise ValueError(f"its runs hold {runs.sum()} pixels of {height}x{width}")
        if height * width > MAX_PIXELS:
            raise ValueError(f"{height}x{width} pixels are no photo's")
    except BAD_RLE as error:
        raise _unreadable_rle(source, error) from error
    values = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return torch.from_numpy(np.ascontiguousarray(values.reshape(width, height).T))


def _rle_size(rle: Any, source: Path) -> tuple[int, int]:
    """Width and height."""
    try:
        height, width = (int(side) for side in rle["size"])
    except BAD_RLE as error:
        raise _unreadable_rle(source, error) from error
    return width, height


def _unreadable_rle(source: Path, error: Exception) -> StyleSplatError:
    return StyleSplatError(
        f"Cannot read a mask in {source}: {error!r}. Polygons are not understood: export RLE."
    )


def _unpack(text: str) -> list[int]:
    """Run lengths from COCO's string: groups of 5 bits, and differences to the last but one."""
    runs: list[int] = []
    value = shift = 0
    for letter in text:
        group = ord(letter) - 48
        value |= (group & 0x1F) << shift
        shift += 5
        if not group & 0x20:
            if group & 0x10:  # negative
                value -= 1 << shift
            runs.append(value + runs[-2] if len(runs) > 2 else value)
            value = shift = 0
    return runs

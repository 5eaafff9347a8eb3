"""Masks of other programs, as label maps: pictures of ids, binary masks by object, COCO's RLE."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import kind_of
from stylesplat.io.label_maps import DrawnLabels, read_label_map
from stylesplat.masks.coco import decode_rle, read_coco, rle_size
from stylesplat.masks.photo_names import match_photos, photo_key
from stylesplat.scene.labels import MAX_ID, Labels, Mask, ids_of


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
    refuse_foreign(source)
    if source.suffix.lower() == ".json":
        found = _coco(source, names)
    else:
        found = _by_object(source, names) or _by_photo(source, names)
    if not found.maps:
        raise StyleSplatError(
            f"No mask in {source} belongs to a photo of this capture. Name them like the photos: "
            f"{photo_key(names[0])}.png."
        )
    return found


def refuse_foreign(source: Path) -> None:
    """Refuse what can be no masks of another program, before the photos are looked at.

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
        raise StyleSplatError(f"There is no folder or .json file {source}. Check --from.")


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
    return len(ids_of(read_label_map(path))) <= 2


def _stack(layers: Sequence[tuple[int, Path]]) -> DrawnLabels:
    first = DrawnLabels.on_disk(layers[0][1])
    return replace(first, read=partial(_stacked, layers))


def _stacked(layers: Sequence[tuple[int, Path]]) -> Labels:
    """One label map of binary masks; smaller objects lie over larger ones."""
    return overlaid((number, read_label_map(path) != 0) for number, path in layers)


def overlaid(masks: Iterable[tuple[int, Mask]]) -> Labels:
    """A label map of masks by id, taken one by one; where they overlap the smaller one shows.

    Raises:
        StyleSplatError: If they differ in size.
    """
    labels = areas = torch.zeros(0, 0, dtype=torch.int32)
    for place, (number, mask) in enumerate(masks):
        if place == 0:
            labels = torch.zeros(mask.shape, dtype=torch.int32)
            areas = torch.full_like(labels, mask.numel())  # of what shows there
        if mask.shape != labels.shape:
            raise _differ("of a photo", *(each.shape[::-1] for each in (mask, labels)))
        area = int(mask.sum())
        shown = mask & (areas >= area)
        labels.masked_fill_(shown, number)
        areas.masked_fill_(shown, area)
    return labels


def _coco(source: Path, names: Sequence[str]) -> Found:
    """Annotations with RLE masks."""
    layers = read_coco(source)
    matches = match_photos(layers.by_photo, names)
    maps = {
        photo: DrawnLabels(
            size=_shared_size(layers.by_photo[file], file, source),
            read=partial(_decoded, layers.by_photo[file], source),
            what=f"of {file} in {source}",
        )
        for file, photo in matches.items()
    }
    return Found(maps, dict(layers.names))


def _shared_size(layers: Sequence[tuple[int, Any]], file: str, source: Path) -> tuple[int, int]:
    sizes = {rle_size(rle, source) for _, rle in layers}
    if len(sizes) > 1:
        raise _differ(f"of {file} in {source}", *sorted(sizes)[:2])
    return sizes.pop()


def _decoded(layers: Sequence[tuple[int, Any]], source: Path) -> Labels:
    return overlaid((number, decode_rle(rle, source)) for number, rle in layers)


def _differ(what: str, *sizes: Sequence[int]) -> StyleSplatError:
    shown = " and ".join(f"{width}x{height}" for width, height in sizes)
    return StyleSplatError(
        f"The masks {what} differ in size: {shown}. Export them at the photo's size."
    )

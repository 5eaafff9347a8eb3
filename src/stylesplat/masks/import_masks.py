"""Masks of other programs as label maps: pictures of ids, binary masks by object, COCO's RLE."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path, PurePosixPath
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import kind_of
from stylesplat.io.label_maps import DrawnLabels, read_label_map
from stylesplat.masks.coco import decode_rle, read_coco, rle_size
from stylesplat.scene.labels import BACKGROUND, MAX_ID, Labels, Mask, OwnLabels, ids_of

SAMPLED = 3  # masks of an object that tell whether they are binary


@dataclass(frozen=True, eq=False)
class ImportedMasks:
    """Label maps of photos from another program's output."""

    maps: dict[str, DrawnLabels]
    """By photo its label map, read on access; photos without one are left out."""
    names: dict[int, str] = field(default_factory=dict)
    """Names of objects by id, where they are known."""


def import_label_maps(source: Path, names: Sequence[str]) -> ImportedMasks:
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
    if source.suffix.lower() == ".json":
        found = _import_coco(source, names)
    else:
        found = _import_by_object(source, names)
    if found is None:
        files = _find_pictures(source)
        matches = match_files(files, names).items()
        found = ImportedMasks({photo: DrawnLabels.on_disk(files[key]) for key, photo in matches})
    if not found.maps:
        raise StyleSplatError(
            f"No mask in {source} belongs to a photo of this capture. Name them like the photos: "
            f"{_without_suffix(names[0])}.png."
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


def _import_by_object(source: Path, names: Sequence[str]) -> ImportedMasks | None:
    """A sub-folder for each object, the masks in it named like the photos."""
    folders = sorted(path for path in source.iterdir() if path.is_dir())
    photo_folders = {PurePosixPath(name).parts[0] for name in names if "/" in name}
    if any(folder.name in photo_folders for folder in folders):
        return None
    masks = {folder: _find_masks(folder, names) for folder in folders}
    objects = {folder: files for folder, files in masks.items() if files}
    sample = chain.from_iterable(islice(files.values(), SAMPLED) for files in objects.values())
    if not objects or not all(len(ids_of(read_label_map(path))) <= 2 for path in sample):
        return None
    ids = _object_ids([folder.name for folder in objects])
    found: dict[str, list[tuple[int, Path]]] = {}
    for id, files in zip(ids, objects.values(), strict=True):
        for photo, path in files.items():
            found.setdefault(photo, []).append((id, path))
    titles = {id: name for id, name in ids.items() if not name.isdecimal()}

    def overlay(layers: Sequence[tuple[int, Path]]) -> Labels:
        return overlay_masks((id, read_label_map(path) != 0) for id, path in layers)

    maps = {
        photo: replace(DrawnLabels.on_disk(layers[0][1]), read=partial(overlay, layers))
        for photo, layers in found.items()
    }
    return ImportedMasks(maps, titles)


def _find_pictures(folder: Path) -> dict[str, Path]:
    """The pictures in a folder and below, by their path in it, without suffix."""
    paths = sorted(folder.rglob("*.png"))
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in paths}


def _find_masks(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """The pictures in a folder by photo: those with a photo's path or, without folder, name."""
    paths = {_without_suffix(name) for name in names}
    own = {key: p for key, p in _find_pictures(folder).items() if key in paths or "/" not in key}
    return {photo: own[key] for key, photo in match_files(own, names).items()}


def _object_ids(folders: Sequence[str]) -> dict[int, str]:
    """Names of folders by id: by the numbers that they are named by, else counted from 1."""
    numbers = {int(name): name for name in folders if name.isdecimal()}
    if len(numbers) == len(folders) and all(0 < number <= MAX_ID for number in numbers):
        return numbers
    return dict(enumerate(folders, start=1))


def _import_coco(source: Path, names: Sequence[str]) -> ImportedMasks:
    by_photo, titles = read_coco(source)

    def decode(layers: Sequence[tuple[int, Any]]) -> Labels:
        return overlay_masks((id, decode_rle(rle, source)) for id, rle in layers)

    maps = {}
    for file, photo in match_files(by_photo, names).items():
        layers, what = by_photo[file], f"of {file} in {source}"
        sizes = sorted({rle_size(rle, source) for _, rle in layers})
        if len(sizes) > 1:
            raise _sizes_differ(what, *sizes[:2])
        maps[photo] = DrawnLabels(size=sizes[0], read=partial(decode, layers), what=what)
    return ImportedMasks(maps, titles)


def overlay_masks(masks: Iterable[tuple[int, Mask]]) -> Labels:
    """A label map of masks by id, taken one by one; where they overlap the smaller one shows."""
    labels = areas = torch.zeros(0, 0, dtype=torch.int32)
    for number, (id, mask) in enumerate(masks):
        if number == 0:
            labels = torch.zeros(mask.shape, dtype=torch.int32)
            areas = torch.full_like(labels, mask.numel())  # of the mask that shows
        if mask.shape != labels.shape:
            raise _sizes_differ("of a photo", *(each.shape[::-1] for each in (mask, labels)))
        area = int(mask.sum())
        on_top = mask & (areas >= area)
        labels.masked_fill_(on_top, id)
        areas.masked_fill_(on_top, area)
    return labels


def _sizes_differ(what: str, *sizes: Sequence[int]) -> StyleSplatError:
    text = " and ".join(f"{width}x{height}" for width, height in sizes)
    return StyleSplatError(
        f"The masks {what} differ in size: {text}. Export them at the photo's size."
    )


def match_files(keys: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """The photo of each mask file, by its path without suffix; files of no photo are left out.

    That is the photo whose path the file's path ends with. If there is none, the file's bare name
    decides, as long as it lies in no folder of photos and only one photo has that name.

    Raises:
        StyleSplatError: If two files are of one photo, or a file is of one of several of which not
            all have another.
    """
    by_path: dict[str, list[str]] = {}
    by_stem: dict[str, list[str]] = {}
    for name in names:
        by_path.setdefault(_without_suffix(name), []).append(name)
        by_stem.setdefault(PurePosixPath(name).stem, []).append(name)
    folders = {PurePosixPath(name).parent.as_posix() for name in names} - {"."}

    def photos_by_stem(key: str) -> list[str]:
        *folder, stem = PurePosixPath(key).parts
        among_photos = any(end in folders for end in _path_ends("/".join(folder)))
        return [] if among_photos else by_stem.get(stem, [])

    found = {k: next((by_path[e] for e in _path_ends(k) if e in by_path), []) for k in keys}
    matches = {key: photos[0] for key, photos in found.items() if len(photos) == 1}
    taken = {*matches.values()}
    for key in [key for key in found if key not in matches]:
        photos = found[key] or photos_by_stem(key)
        left = [photo for photo in photos if photo not in taken]
        if left and len(photos) > 1:
            raise StyleSplatError(
                f"The mask {key} may be of {photos[0]} or of {photos[1]}. Name masks like the "
                f"photos, with their folders: {_without_suffix(left[0])}.png."
            )
        if left:
            matches[key] = left[0]
    used: dict[str, str] = {}
    for key, photo in matches.items():
        if (other := used.setdefault(photo, key)) != key:
            raise StyleSplatError(
                f"Both {other} and {key} are named like {photo}. Give the folder of one kind."
            )
    return matches


def _path_ends(path: str) -> list[str]:
    parts = PurePosixPath(path).parts
    return ["/".join(parts[start:]) for start in range(len(parts))]


def _without_suffix(name: str) -> str:
    return PurePosixPath(name).with_suffix("").as_posix()

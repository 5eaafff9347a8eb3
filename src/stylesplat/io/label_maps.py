"""Label maps: pictures whose pixels are the ids of objects, 0 where there is none."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated

import msgspec
import numpy as np
import torch
from jaxtyping import Int
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import REPLACING, atomic_folder, atomic_path, refuse_occupied
from stylesplat.io.captures.photos import Photo, same_shape
from stylesplat.io.files import is_file, require_regular, resolve_within
from stylesplat.io.images import image_sizes
from stylesplat.io.json_yaml import convert_checked, read_json, write_json
from stylesplat.io.kinds import PHOTOS, kind_of
from stylesplat.io.mask_pictures import (
    IDS_NOTE,
    RGB_CODE,
    Reading,
    find_reading,
    match_masks,
    read_label_map,
    read_mask,
    without_suffix,
)
from stylesplat.progress import say, track
from stylesplat.scene.capture import (
    BACKGROUND,
    MAX_ID,
    Capture,
    Labels,
    Mask,
    OwnLabels,
    ids_of,
    resize_labels,
)
from stylesplat.scene.sequences import Lazy

LABEL_MAPS_NAMES = "names.json"  # beside the label maps: the objects' names by id

LABEL_SAMPLED = 3  # masks of an object that tell whether they are binary

IdText = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{1,8}\Z")]


def write_label_map(labels: Int[Tensor, "H W"], path: Path | str) -> None:
    """Write ids as a PNG of 8 bits, 16 bits or RGB, the smallest that holds them."""
    if labels.numel() and not 0 <= labels.min() <= labels.max() <= MAX_ID:
        raise StyleSplatError(
            f"Cannot write {path}: label ids go from 0 to {MAX_ID}. Give the objects other ids."
        )
    ids = labels.cpu().numpy()
    if ids.max(initial=0) < 2**8:
        pixels = ids.astype(np.uint8)
    elif ids.max() < 2**16:
        pixels = ids.astype(np.uint16)
    else:
        pixels = (ids[:, :, None] // RGB_CODE % 256).astype(np.uint8)
    note = PngInfo()
    note.add_text(*IDS_NOTE)
    with atomic_path(path) as draft:
        Image.fromarray(pixels).save(draft, format="PNG", pnginfo=note)


@dataclass(frozen=True, eq=False)
class DrawnLabels:
    """A label map as somebody drew it on a photo, read on demand."""

    size: tuple[int, int]
    """Width and height."""
    read: Callable[[], OwnLabels]
    what: str
    """Its name in messages."""

    @classmethod
    def on_disk(cls, path: Path, reading: Reading = "ids") -> "DrawnLabels":
        """The label map of a file, of which only the header is read now."""
        return cls(image_sizes(path)[0], partial(read_mask, path, reading), str(path))


@dataclass(frozen=True, eq=False)
class FoundMasks:
    """Label maps of photos, perhaps from another program."""

    maps: dict[str, DrawnLabels]
    """By photo its label map, read on access; photos without one are left out."""
    names: dict[int, str] = field(default_factory=dict)
    """Names of objects by id, where they are known."""


def find_masks(folder: Path, names: Sequence[str]) -> FoundMasks:
    """Find the masks of photos in a folder.

    They may be pictures of ids or of one object, named like the photos, in any sub-folder; or a
    sub-folder per object with a mask of it per photo. How they are read is told from all together.
    Raises a StyleSplatError if a mask is of several photos, or they are neither ids nor masks.
    """
    files = mask_files(folder)
    exact = {without_suffix(name) for name in names} | {*names}
    found = None if exact & files.keys() else _by_object(folder, names)
    if found is None:
        matches = match_masks(files, names)
        reading, why = find_reading([files[key] for key in matches])
        if reading is None:
            raise StyleSplatError(why)
        if why:
            say(f"The masks in {folder} are of one object: {why}.")
        drawn = {photo: DrawnLabels.on_disk(files[key], reading) for key, photo in matches.items()}
        found = FoundMasks(drawn)
    return replace(found, names={**found.names, **read_names(folder)})


def mask_files(folder: Path) -> dict[str, Path]:
    """The pictures below a folder by path without suffix; only PNGs if there are some."""
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in PHOTOS)
    files = [path for path in found if path.suffix.lower() == ".png"] or found
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in files}


def _by_object(folder: Path, names: Sequence[str]) -> FoundMasks | None:
    """A sub-folder for each object, the masks in it named like the photos."""
    folders = sorted(path for path in folder.iterdir() if path.is_dir())
    photo_folders = {PurePosixPath(name).parts[0] for name in names if "/" in name}
    if any(each.name in photo_folders for each in folders):
        return None
    masks = {each: own for each in folders if (own := _masks_in(each, names))}
    readings = dict[Path, Reading]()
    reasons = dict[str, None]()
    for each, files in masks.items():
        reading, why = find_reading([*files.values()])
        sample = [*files.values()][:LABEL_SAMPLED]
        if reading is None or (
            reading == "ids" and any(len(ids_of(read_label_map(path))) > 2 for path in sample)
        ):
            return None
        readings[each] = reading
        reasons |= {why: None} if why else {}
    if not masks:
        return None
    for why in reasons:
        say(f"The folders in {folder} have the masks of an object each: {why}.")
    ids = _object_ids([each.name for each in masks])
    found = dict[str, list[tuple[int, Path, Reading]]]()
    for id, (each, files) in zip(ids, masks.items(), strict=True):
        for photo, path in files.items():
            found.setdefault(photo, []).append((id, path, readings[each]))

    def overlay(layers: Sequence[tuple[int, Path, Reading]]) -> Labels:
        return overlay_masks((id, read_mask(path, how) != 0) for id, path, how in layers)

    maps = {
        photo: replace(DrawnLabels.on_disk(layers[0][1]), read=partial(overlay, layers))
        for photo, layers in found.items()
    }
    return FoundMasks(maps, {id: name for id, name in ids.items() if not name.isdecimal()})


def _masks_in(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """The pictures in a folder by photo: those with a photo's path or, without folder, name."""
    paths = {without_suffix(name) for name in names} | {*names}
    own = {key: p for key, p in mask_files(folder).items() if key in paths or "/" not in key}
    return {photo: own[key] for key, photo in match_masks(own, names).items()}


def _object_ids(folders: Sequence[str]) -> dict[int, str]:
    """Names of folders by id: by the numbers that they are named by, else counted from 1."""
    numbers = {int(name): name for name in folders if name.isdecimal()}
    if len(numbers) == len(folders) and all(0 < number <= MAX_ID for number in numbers):
        return numbers
    return dict(enumerate(folders, start=1))


def overlay_masks(masks: Iterable[tuple[int, Mask]]) -> Labels:
    """A label map of masks by id, taken one by one; where they overlap the smaller one shows."""
    labels = areas = torch.zeros(0, 0, dtype=torch.int32)
    for number, (id, mask) in enumerate(masks):
        if number == 0:
            labels = torch.zeros(mask.shape, dtype=torch.int32)
            areas = torch.full_like(labels, mask.numel())  # of the mask that shows
        if mask.shape != labels.shape:
            raise sizes_differ("of a photo", *(each.shape[::-1] for each in (mask, labels)))
        area = int(mask.sum())
        on_top = mask & (areas >= area)
        labels.masked_fill_(on_top, id)
        areas.masked_fill_(on_top, area)
    return labels


def sizes_differ(what: str, *sizes: Sequence[int]) -> StyleSplatError:
    text = " and ".join(f"{width}x{height}" for width, height in sizes)
    return StyleSplatError(
        f"The masks {what} differ in size: {text}. Export them at the photo's size."
    )


def read_names(folder: Path) -> dict[int, str]:
    """The objects' names by id in a folder of label maps; empty if it has no `names.json`."""
    path = folder / LABEL_MAPS_NAMES
    require_regular(path)
    if not path.exists():
        return {}
    expected = f"Cannot read {path}: expected names by label id"
    names = convert_checked(read_json(path), dict[IdText, str], expected, "Mend or delete it.")
    return {int(id): name for id, name in names.items()}


def write_names(names: Mapping[int, str], folder: Path) -> None:
    """Write `names.json` into a folder of label maps, unless there are no names."""
    if names:
        write_json({str(id): name for id, name in names.items()}, folder / LABEL_MAPS_NAMES)


def match_label_maps(folder: Path, names: Sequence[str]) -> FoundMasks:
    """The masks of photos in the folder of `--masks`, of which one has to be there."""
    if (kind := kind_of(folder)) in ("capture", "scene"):
        raise StyleSplatError(f"{folder} is a {kind}, not a folder of masks. Check `--masks`.")
    if not folder.is_dir():
        raise StyleSplatError(f"There is no folder {folder} with label maps. Check `--masks`.")
    found = find_masks(folder, names)
    if not found.maps:
        files = mask_files(folder)
        if not files:
            raise StyleSplatError(
                f"There are no label maps in {folder}: it holds no pictures. Check `--masks`."
            )
        raise StyleSplatError(
            f"None of the {len(files)} label maps in {folder} is named after a photo. "
            f"Name them like {without_suffix(names[0])}.png, or check `--masks`."
        )
    return found


def fitted_maps(
    found: FoundMasks, names: Sequence[str], photos: Sequence[Photo]
) -> Lazy[Int[Tensor, "H W"] | None]:
    """The label map of each photo, read on access at the size of `photos`; None without one."""
    maps = found.maps
    return Lazy(
        [
            fit_labels(maps[name], photo) if name in maps else lambda: None
            for name, photo in zip(names, photos, strict=True)
        ]
    )


def fit_labels(drawn: DrawnLabels, photo: Photo) -> Callable[[], OwnLabels]:
    """A function that reads a label map undistorted, at the photo's size."""
    width, height = drawn.size
    if drawn.size == photo.lens.pinhole().size:  # drawn on the undistorted photo, as `mask` does
        return lambda: resize_labels(drawn.read(), photo.size[::-1])
    lens = photo.lens
    if photo.taken is not None and drawn.size == photo.taken.size:
        lens = photo.taken  # drawn on the photo as it was before `sfm` undistorted it
    if not same_shape(drawn.size, lens.size):
        raise StyleSplatError(
            f"The label map {drawn.what} is {width}x{height}, which is not the shape of its photo "
            f"({lens.width}x{lens.height}). Make it from that photo."
        )

    def undistorted() -> OwnLabels:
        whole = resize_labels(drawn.read().int(), lens.size[::-1]).numpy()
        pixels = torch.from_numpy(lens.undistort(whole, nearest=True))
        return resize_labels(pixels, photo.size[::-1])

    return undistorted


def refuse_label_maps(capture: Capture, folder: Path, *, overwrite: bool) -> None:
    """Raise a StyleSplatError unless `write_label_maps` can write here; ask before the work."""
    names = capture.cameras.names
    if len({Path(name).with_suffix("") for name in names}) < len(names):
        raise StyleSplatError(
            f"Some photos in {capture.path} differ in their suffix only, so their label maps would "
            "have one name. Rename them."
        )
    paths = [_map_path(folder, name) for name in names]
    if not overwrite and any(map(is_file, paths)):
        raise StyleSplatError(f"{folder} holds label maps already. Replace them with {REPLACING}.")
    refuse_occupied(folder, marker="", overwrite=overwrite)


def write_label_maps(
    capture: Capture, folder: Path, *, overwrite: bool = False
) -> dict[str, set[int]]:
    """Write the label maps of a capture and the objects' names, all or none of them.

    They are undistorted and have the size of the photos on disk, whatever size the capture is
    opened at; other files in the folder stay. Returns the ids in each map by photo.
    """
    if capture.label_maps is None:
        raise StyleSplatError("This capture has no label maps to write. `mask` makes some.")
    refuse_label_maps(capture, folder, overwrite=overwrite)
    written, stale = dict[str, set[int]](), list[str]()
    with atomic_folder(folder, overwrite=overwrite, marker="", stale=stale) as draft:
        for row, name in enumerate(track(capture.cameras.names, "label maps", unit="photo")):
            labels = capture.label_maps[row]
            if labels is None:
                stale.append(str(Path(name).with_suffix(".png")))
            else:
                whole = resize_labels(labels, capture.full_cameras[row].size[::-1])
                write_label_map(whole, _map_path(draft, name))
                written[name] = ids_of(whole) - {BACKGROUND}
        ids = sorted(set[int]().union(*written.values()) & capture.object_names.keys())
        write_names({id: capture.object_names[id] for id in ids}, draft)
        stale += [] if ids else [LABEL_MAPS_NAMES]
    return written


def _map_path(folder: Path, name: str) -> Path:
    return resolve_within(folder, name).with_suffix(".png")

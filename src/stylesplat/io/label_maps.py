"""Label maps: pictures whose pixels are the ids of objects, 0 where there is none."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import torch
from jaxtyping import Int
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import REPLACING, atomic_folder, atomic_path, refuse_occupied
from stylesplat.io.captures.photos import Photo, same_shape
from stylesplat.io.files import inside, is_file, require_regular
from stylesplat.io.images import image_sizes, open_image
from stylesplat.io.json_files import fitting, read_json, write_json
from stylesplat.progress import track
from stylesplat.scene.cache import Lazy
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import BACKGROUND, MAX_ID, OwnLabels, ids_of, resize_labels

RGB_CODE = np.array([1, 256, 65536], dtype=np.int32)  # id = r + 256 g + 65536 b
ID_MODES = ("1", "L", "P", "I", "I;16", "RGB", "RGBA")  # of Pillow
NAMES = "names.json"  # beside the label maps: the objects' names by id

LabelId = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{1,8}\Z")]


def read_label_map(path: Path | str) -> Int[Tensor, "H W"]:
    """Read ids from 8-bit, 16-bit, palette (the index counts) or RGB-coded pixels."""
    with open_image(Path(path)) as image:
        if image.format == "JPEG" or image.mode not in ID_MODES:
            raise ValueError(f"{image.format} pixels of type {image.mode} cannot be label ids")
        pixels = np.asarray(image).astype(np.int32)
        return torch.from_numpy(pixels if pixels.ndim == 2 else pixels[:, :, :3] @ RGB_CODE)


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
    with atomic_path(path) as draft:
        Image.fromarray(pixels).save(draft, format="PNG")


@dataclass(frozen=True, eq=False)
class DrawnLabels:
    """A label map as somebody drew it on a photo, read on demand."""

    size: tuple[int, int]
    """Width and height."""
    read: Callable[[], OwnLabels]
    what: str
    """Its name in messages."""

    @classmethod
    def on_disk(cls, path: Path) -> "DrawnLabels":
        """The label map of a file, of which only the header is read now."""
        return cls(image_sizes(path)[0], partial(read_label_map, path), str(path))


def read_names(folder: Path) -> dict[int, str]:
    """The objects' names by id in a folder of label maps; empty if it has no `names.json`."""
    path = folder / NAMES
    require_regular(path)
    if not path.exists():
        return {}
    expected = f"Cannot read {path}: expected names by label id"
    names = fitting(read_json(path), dict[LabelId, str], expected, "Mend or delete it.")
    return {int(id): name for id, name in names.items()}


def write_names(names: Mapping[int, str], folder: Path) -> None:
    """Write `names.json` into a folder of label maps, unless there are no names."""
    if names:
        write_json({str(id): name for id, name in names.items()}, folder / NAMES)


def match_label_maps(
    folder: Path, names: Sequence[str], photos: Sequence[Photo]
) -> Lazy[Int[Tensor, "H W"] | None]:
    """The label map of each photo, by file name without extension; None where there is none.

    The maps are read on access, at the size of `photos`. Raises a StyleSplatError if no map belongs
    to any photo, or one is no picture or not of its photo's shape.
    """
    if not folder.is_dir():
        raise StyleSplatError(f"There is no folder {folder} with label maps. Check `--masks`.")
    files = {_key(path.relative_to(folder)): path for path in sorted(folder.rglob("*.png"))}
    paths = [files.get(_key(Path(name))) or files.get(name) for name in names]
    if not files:
        raise StyleSplatError(
            f"There are no label maps in {folder}: it holds no PNG files. Check `--masks`."
        )
    if not any(paths):
        raise StyleSplatError(
            f"None of the {len(files)} label maps in {folder} is named after a photo. "
            f"Name them like {_key(Path(names[0]))}.png, or check `--masks`."
        )
    return Lazy(
        [
            fit_labels(DrawnLabels.on_disk(path), photo) if path else lambda: None
            for path, photo in zip(paths, photos, strict=True)
        ]
    )


def fit_labels(drawn: DrawnLabels, photo: Photo) -> Callable[[], OwnLabels]:
    """A function that reads a label map undistorted, at the photo's size."""
    width, height = drawn.size
    if drawn.size == photo.lens.pinhole().size:  # drawn on the undistorted photo, as `mask` does
        return lambda: resize_labels(drawn.read(), photo.size[::-1])
    if not same_shape(drawn.size, photo.lens.size):
        raise StyleSplatError(
            f"The label map {drawn.what} is {width}x{height}, which is not the shape of its photo "
            f"({photo.lens.width}x{photo.lens.height}). Make it from that photo."
        )

    def undistorted() -> OwnLabels:
        whole = resize_labels(drawn.read().int(), photo.lens.size[::-1]).numpy()
        pixels = torch.from_numpy(photo.lens.undistort(whole, nearest=True))
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
        stale += [] if ids else [NAMES]
    return written


def _map_path(folder: Path, name: str) -> Path:
    return inside(folder, name).with_suffix(".png")


def _key(path: Path) -> str:
    return path.with_suffix("").as_posix()

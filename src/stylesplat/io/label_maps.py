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
from stylesplat.io.captures.decoding import in_bands, opened
from stylesplat.io.captures.photos import Photo, photo_sizes, same_shape
from stylesplat.io.files import atomic_path, require_regular
from stylesplat.io.json_files import fitting, read_json, write_json
from stylesplat.io.recovery import ensure_whole
from stylesplat.scene.cache import Lazy
from stylesplat.scene.labels import MAX_ID, OwnLabels, resize_labels

RGB_CODE = np.array([1, 256, 65536], dtype=np.int32)  # id = r + 256 g + 65536 b
ID_MODES = ("1", "L", "P", "I", "I;16", "RGB", "RGBA")  # of Pillow
NAMES = "names.json"  # beside the label maps: what objects are called, by id

LabelId = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{1,8}\Z")]


def read_label_map(path: Path | str) -> Int[Tensor, "H W"]:
    """Read ids from 8-bit, 16-bit, palette (the index counts) or RGB-coded pixels.

    Raises:
        StyleSplatError: If there is no such file or its pixels cannot be ids.
    """
    with opened(Path(path)) as image:
        if image.format == "JPEG" or image.mode not in ID_MODES:
            raise ValueError(f"{image.format} pixels of type {image.mode} cannot be label ids")
        return torch.from_numpy(in_bands(image, _ids))


def write_label_map(labels: Int[Tensor, "H W"], path: Path | str) -> None:
    """Write ids as a PNG of 8 bits, 16 bits or RGB, whichever is the smallest that holds them.

    Raises:
        StyleSplatError: If an id is negative or above 2**24 - 1, or the file cannot be written.
    """
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
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG")


@dataclass(frozen=True)
class DrawnLabels:
    """A label map as somebody drew it on a photo, which is read when it is asked for."""

    size: tuple[int, int]
    """Width and height."""
    read: Callable[[], OwnLabels]
    """What reads it."""
    what: str
    """What to call it where it does not fit."""

    @classmethod
    def on_disk(cls, path: Path) -> "DrawnLabels":
        """That of a file, of which only the header is read.

        Raises:
            StyleSplatError: If there is no such file or it is no picture.
        """
        return cls(photo_sizes(path)[0], partial(read_label_map, path), str(path))


def read_names(folder: Path) -> dict[int, str]:
    """What the objects of a folder of label maps are called, by id; empty if nothing says it.

    Raises:
        StyleSplatError: If the file that says it is damaged.
    """
    path = folder / NAMES
    require_regular(path)
    if not path.exists():
        return {}
    expected = f"Cannot read {path}: expected names by label id"
    names = fitting(read_json(path), dict[LabelId, str], expected, "Mend or delete it.")
    return {int(id): name for id, name in names.items()}


def write_names(names: Mapping[int, str], folder: Path) -> None:
    """Say in a folder of label maps what objects are called.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    if names:
        write_json({str(id): name for id, name in names.items()}, folder / NAMES)


def match_label_maps(
    folder: Path, names: Sequence[str], photos: Sequence[Photo]
) -> Lazy[Int[Tensor, "H W"] | None]:
    """The label map of each photo, by file name without extension; None where there is none.

    Args:
        folder: Holds PNG files, in subfolders where the names have any.
        names: The photos' names.
        photos: The photos, which say how large the maps shall be.

    Raises:
        StyleSplatError: If the folder is missing, no map is any photo's, or one is no picture or
            not of its photo's shape.
    """
    if not folder.is_dir():
        raise StyleSplatError(f"There is no folder {folder} with label maps. Check `--masks`.")
    ensure_whole(folder)
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
            fit_labels(DrawnLabels.on_disk(path), photo) if path else _none
            for path, photo in zip(paths, photos, strict=True)
        ]
    )


def fit_labels(drawn: DrawnLabels, photo: Photo) -> Callable[[], OwnLabels]:
    """What reads a label map as the pinhole camera of its photo sees it, at the photo's size.

    Raises:
        StyleSplatError: If the label map is not of the photo's shape.
    """
    width, height = drawn.size
    if drawn.size == photo.lens.pinhole().size:  # drawn on the undistorted photo, as `mask` does
        return lambda: resize_labels(drawn.read(), photo.size[::-1])
    if not same_shape(drawn.size, photo.lens.size):
        raise StyleSplatError(
            f"The label map {drawn.what} is {width}x{height}, which is not the shape of its photo "
            f"({photo.lens.width}x{photo.lens.height}). Make it from that photo."
        )
    return partial(_undistorted, drawn, photo)


def _undistorted(drawn: DrawnLabels, photo: Photo) -> OwnLabels:
    whole = resize_labels(drawn.read().int(), photo.lens.size[::-1]).numpy()
    seen = torch.from_numpy(photo.lens.undistort(whole, nearest=True))
    return resize_labels(seen, photo.size[::-1])


def _none() -> None:
    return None


def _key(path: Path) -> str:
    return path.with_suffix("").as_posix()


def _ids(image: Image.Image) -> Int[np.ndarray, "H W"]:
    pixels = np.asarray(image).astype(np.int32)
    return pixels if pixels.ndim == 2 else pixels[:, :, :3] @ RGB_CODE

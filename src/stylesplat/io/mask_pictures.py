"""Pictures as masks: ids of objects, or one object whose mask may have soft edges.

Pixels alone do not say what they mean: 255 may be an id, or white. How the pictures of a folder
look together does. Regions of ids are flat. Greys of a soft edge are not, and lie between black
and white; opacity is that of a cut-out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Int, Integer, UInt8
from PIL import Image
from scipy.ndimage import binary_dilation, label

from stylesplat.errors import StyleSplatError
from stylesplat.io.images import open_image
from stylesplat.scene.labels import OwnLabels
from stylesplat.scene.sampling import evenly

RGB_CODE = np.array([1, 256, 65536], dtype=np.int32)  # id = r + 256 g + 65536 b
IDS_NOTE = ("Comment", "StyleSplat label ids")  # in PNGs of ours, of which an id may be 255
ID_MODES = ("1", "L", "P", "I", "I;16", "RGB", "RGBA")  # of Pillow
GREY_MODES = ("1", "L", "LA", "I", "I;16", "I;16B")
LOSSY = ("JPEG", "MPO", "WEBP", "AVIF")  # formats, which may change ids
SAMPLED = 12  # pictures of a folder that tell what their pixels mean
HALF = 128  # of 255: opacity or light from which a pixel is the object's
# Greys from which a pixel is black or white for sure: JPEG and sharpening blur around edges
DARK, BRIGHT = 24, 231
CLEAR = 0.5  # share of such pixels in masks, and of edges between black and white in what is left
NOISE = 0.01  # share of greys that JPEG makes beside edges at most
FLAT = 0.3  # share of flat pixels in regions of ids; soft edges of the fox have .02, its ids .97
MANY_COLORS = 64  # different ones in a picture: maps of ids have fewer where they are not flat

Reading = Literal["ids", "levels", "alpha"]
"""What pixels mean: ids; or one object, by how light or how opaque they are."""


@dataclass(frozen=True, eq=False)
class _Pixels:
    ids: Int[np.ndarray, "H W"]
    levels: UInt8[np.ndarray, "H W"] | None
    """How light they are; None for colours."""
    alpha: UInt8[np.ndarray, "H W"] | None
    lossy: bool


def read_label_map(path: Path | str) -> OwnLabels:
    """Read ids from 8-bit, 16-bit, palette (the index counts) or RGB-coded pixels."""
    with open_image(Path(path)) as image:
        if image.format == "JPEG" or image.mode not in ID_MODES:
            raise ValueError(f"{image.format} pixels of type {image.mode} cannot be label ids")
        return torch.from_numpy(_ids(image))


def read_mask(path: Path, reading: Reading) -> OwnLabels:
    """Read a picture as ids, or as those of one object: 1 where it is, else 0."""
    pixels = _decode(path)
    if reading == "ids":
        shown = pixels.ids if pixels.alpha is None else pixels.ids * (pixels.alpha >= HALF)
        return torch.from_numpy(shown)
    levels = pixels.alpha if reading == "alpha" else pixels.levels
    if levels is None:
        what = "opacity" if reading == "alpha" else "greys"
        raise StyleSplatError(
            f"Cannot read the mask {path}: it has no {what}, as others in its folder have. Make "
            "all of them in one way."
        )
    return torch.from_numpy((levels >= HALF).astype(np.int32))


def find_reading(paths: Sequence[Path]) -> tuple[Reading | None, str]:
    """What the pixels of a folder's pictures mean, by some of them together, and why, for users.

    None if they are neither ids nor masks.
    """
    sample = evenly(paths, SAMPLED)
    if all(map(_is_own, sample)):
        return "ids", ""
    pictures = [(path, _Look.of(_decode(path))) for path in sample]
    looks = [look for _, look in pictures]
    is_mask = _is_mask(looks)
    if any(look.is_cut_out for look in looks) and (
        is_mask or not any(look.has_ids for look in looks)
    ):
        return "alpha", "what is opaque is the object"
    if is_mask:
        soft = any(look.between for look in looks)
        edges = "their edges are soft, and half or more is" if soft else "what is white is"
        return "levels", f"{edges} the object"
    for path, look in pictures:
        if look.fault:
            return None, f"Cannot read the mask {path}: {look.fault}"
    return "ids", ""


@dataclass(frozen=True)
class _Look:
    """What tells the meaning of a picture's pixels; numbers are of pixels."""

    size: int
    lossy: bool
    is_grey: bool
    has_white: bool
    clear: int = 0
    """Black or white, or nearly so."""
    between: int = 0
    """Neither black nor white."""
    flat: int = 0
    """Of these, in flat regions."""
    edge: int = 0
    """Of these, in regions that touch both black and white."""
    is_cut_out: bool = False
    """Whether a part is transparent."""
    has_ids: bool = False
    """Whether what is opaque has several flat colours."""
    fault: str = ""
    """Why these are no ids."""

    @classmethod
    def of(cls, pixels: _Pixels) -> "_Look":
        opaque = np.ones_like(pixels.ids, bool) if pixels.alpha is None else pixels.alpha >= HALF
        own = opaque & (pixels.ids != 0)
        colors = len(np.unique(pixels.ids[own]))
        is_flat = (own & _is_flat(pixels.ids)).sum() >= FLAT * own.sum()
        numbers = {
            "size": own.size,
            "lossy": pixels.lossy,
            "is_grey": pixels.levels is not None,
            "has_white": False,
        }
        if pixels.levels is not None:
            numbers |= _edges(pixels.levels, lossy=pixels.lossy)
        fault = ""
        if pixels.lossy:
            fault = "its format changes ids, and it is not black and white. Save it as PNG."
        elif colors > MANY_COLORS and not is_flat:
            fault = (
                f"it has {colors:,} different colours, as a photo has. Give ids of objects, or a "
                "mask in black and white."
            )
        return cls(
            **numbers,
            is_cut_out=bool(opaque.any() and not opaque.all()),
            has_ids=bool(is_flat and 1 < colors <= MANY_COLORS),
            fault=fault,
        )


def _edges(levels: UInt8[np.ndarray, "H W"], *, lossy: bool) -> dict[str, int | bool]:
    """What greys say of soft edges; see `_Look`."""
    black, white = (levels <= DARK, levels >= BRIGHT) if lossy else (levels == 0, levels == 255)
    between = ~(black | white)
    regions: np.ndarray = label(between, structure=np.ones((3, 3)))[0]  # pyright: ignore
    touching = [
        np.isin(regions, np.unique(regions[np.asarray(binary_dilation(each), bool) & between]))
        for each in (black, white)
    ]
    return {
        "has_white": bool(white.any()),
        "clear": int(((levels <= DARK) | (levels >= BRIGHT)).sum()),
        "between": int(between.sum()),
        "flat": int((between & _is_flat(levels)).sum()),
        "edge": int((between & touching[0] & touching[1]).sum()),
    }


def _is_mask(looks: Sequence[_Look]) -> bool:
    """Whether pictures are black and white, with nothing but edges between."""
    if not all(look.is_grey for look in looks) or not any(look.has_white for look in looks):
        return False
    size, clear, between, flat, edge = (
        sum(getattr(look, name) for look in looks)
        for name in ("size", "clear", "between", "flat", "edge")
    )
    stray = NOISE * size if any(look.lossy for look in looks) else 0
    is_edge = edge >= CLEAR * between or between <= stray
    return clear >= CLEAR * size and flat <= FLAT * between and is_edge


def _is_flat(ids: Integer[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Which pixels have a neighbour of their value beside them, and one above or below."""
    found = []
    for axis in (0, 1):
        same = np.diff(ids, axis=axis) == 0
        edge = [(0, 0), (0, 0)]
        first, last = edge.copy(), edge.copy()
        first[axis], last[axis] = (1, 0), (0, 1)
        found.append(np.pad(same, first) | np.pad(same, last))
    return found[0] & found[1]


def _is_own(path: Path) -> bool:
    """Whether this package wrote a picture, as ids; reads the header only."""
    with open_image(path) as image:
        return image.info.get(IDS_NOTE[0]) == IDS_NOTE[1]


def _decode(path: Path) -> _Pixels:
    with open_image(path) as image:
        lossy = image.format in LOSSY
        if not lossy and image.mode not in (*ID_MODES, *GREY_MODES):
            raise ValueError(f"{image.format} pixels of type {image.mode} cannot be a mask")
        alpha = None
        if image.has_transparency_data:
            alpha = np.asarray(image.convert("RGBA"))[..., 3]
        return _Pixels(_ids(image), _levels(image), alpha, lossy)


def _ids(image: Image.Image) -> Int[np.ndarray, "H W"]:
    pixels = np.asarray(image).astype(np.int32)
    if image.mode == "LA":
        return np.ascontiguousarray(pixels[..., 0])
    return pixels if pixels.ndim == 2 else pixels[:, :, :3] @ RGB_CODE


def _levels(image: Image.Image) -> UInt8[np.ndarray, "H W"] | None:
    """How light pixels are, of 255; None for colours."""
    if image.mode.startswith("I"):
        return (np.asarray(image) / 257).clip(0, 255).round().astype(np.uint8)
    if image.mode in GREY_MODES:
        return np.asarray(image.convert("L"))
    colors = np.asarray(image.convert("RGB"))
    spread = int((colors.max(axis=2) - colors.min(axis=2)).max())
    return colors.max(axis=2) if spread <= (DARK if image.format in LOSSY else 0) else None

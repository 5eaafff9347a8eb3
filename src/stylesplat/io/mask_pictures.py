"""Pictures as masks: which photo each is of, and what its pixels mean.

Pixels alone do not say that: 255 may be an id, or white. How the pictures of a folder look together
does. Regions of ids are flat. Greys of a soft edge are not, and lie between black and white;
opacity is that of a cut-out.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Int, Integer, UInt8
from PIL import Image
from scipy.ndimage import binary_dilation, label

from stylesplat.errors import StyleSplatError
from stylesplat.io.images import open_image
from stylesplat.progress import say
from stylesplat.scene.capture import OwnLabels
from stylesplat.scene.sequences import evenly_spaced


def match_masks(keys: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """The photo of each mask; masks of no photo are left out.

    If no name fits, upper and lower case do not count; if none fits then, something before or
    after all names, as in `0001_mask`, does not. The `keys` are paths of masks without their
    suffix, which may still have that of the photo. Raises a StyleSplatError if two masks are of one
    photo, or one is of one of several of which not all have another.
    """
    keys = [*keys]
    found = _match(keys, names)
    if found:
        return found
    folded, lower = {key.casefold(): key for key in keys}, {n.casefold(): n for n in names}
    if len(folded) < len(keys) or len(lower) < len(names):
        return {}
    matches = _match([*folded], [*lower]) or _match_affixed([*folded], [*lower])
    return {folded[key]: lower[name] for key, name in matches.items()}


def without_suffix(name: str) -> str:
    return PurePosixPath(name).with_suffix("").as_posix()


def _match(keys: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """The photo of each mask: the one whose path the mask's path ends with.

    If there is none, the mask's bare name decides, as long as it lies in no folder of photos and
    only one photo has that name. A mask that lies just where its photo does precedes others.
    """
    by_path: dict[str, list[str]] = {}
    by_stem: dict[str, list[str]] = {}
    for name in names:
        for path in {name, without_suffix(name)}:
            by_path.setdefault(path, []).append(name)
            by_stem.setdefault(PurePosixPath(path).name, []).append(name)
    folders = {PurePosixPath(name).parent.as_posix() for name in names} - {"."}

    def photos_by_stem(key: str) -> list[str]:
        *folder, stem = PurePosixPath(key).parts
        among_photos = any(end in folders for end in _path_ends("/".join(folder)))
        return [] if among_photos else by_stem.get(stem, [])

    exact = {photo for key in keys if len(own := by_path.get(key, [])) == 1 for photo in own}
    found = {k: next((by_path[e] for e in _path_ends(k) if e in by_path), []) for k in keys}
    matches = {
        key: photos[0]
        for key, photos in found.items()
        if len(photos) == 1 and (key in by_path or photos[0] not in exact)
    }
    taken = {*matches.values()}
    for key in [key for key in found if key not in matches]:
        photos = found[key] or photos_by_stem(key)
        left = [photo for photo in photos if photo not in taken]
        if left and len(photos) > 1:
            raise StyleSplatError(
                f"The mask {key} may be of {photos[0]} or of {photos[1]}. Name masks like the "
                f"photos, with their folders: {without_suffix(left[0])}.png."
            )
        if left:
            matches[key] = left[0]
    return _once(matches)


def _match_affixed(keys: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Masks and photos whose names differ by what stands before and behind all of either."""
    masks = [(PurePosixPath(key).name, key) for key in keys]
    photos = [(PurePosixPath(name).stem, name) for name in names]
    for longer, shorter in ((masks, photos), (photos, masks)):
        affixes = Counter(
            (long[:start], long[start + len(short) :])
            for long, _ in longer
            for short, _ in shorter
            if short and (start := long.find(short)) >= 0 and _stands_alone(long, short, start)
        )
        known = dict(shorter)
        for (before, behind), count in affixes.most_common(1):
            pairs = [
                (own, known[long[len(before) : len(long) - len(behind)]])
                for long, own in longer
                if long.startswith(before)
                and long.endswith(behind)
                and long[len(before) : len(long) - len(behind)] in known
            ]
            if 2 * count > len(masks) and len(known) == len(shorter):
                found = _once(dict(pairs if longer is masks else ((m, p) for p, m in pairs)))
                key, photo = next(iter(found.items()))
                say(
                    f"No mask is named like a photo: {key} is taken for that of {photo}, and so on."
                )
                return found
    return {}


def _stands_alone(long: str, short: str, start: int) -> bool:
    """Whether a number in a name is a whole one: 001 is none in 1001."""
    end = start + len(short)
    before = long[start - 1 : start].isdigit() and short[0].isdigit()
    return not before and not (long[end : end + 1].isdigit() and short[-1].isdigit())


def _once(matches: dict[str, str]) -> dict[str, str]:
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


RGB_CODE = np.array([1, 256, 65536], dtype=np.int32)  # id = r + 256 g + 65536 b
IDS_NOTE = ("Comment", "StyleSplat label ids")  # in PNGs of ours, of which an id may be 255
ID_MODES = ("1", "L", "P", "I", "I;16", "RGB", "RGBA")  # of Pillow
GREY_MODES = ("1", "L", "LA", "I", "I;16", "I;16B")
LOSSY = ("JPEG", "MPO", "WEBP", "AVIF")  # formats, which may change ids
MASK_SAMPLED = 12  # pictures of a folder that tell what their pixels mean
MASK_HALF = 128  # of 255: opacity or light from which a pixel is the object's
# Greys from which a pixel is black or white for sure: JPEG and sharpening blur around edges
DARK, BRIGHT = 24, 231
# Share of such pixels in masks, and of edges between black and white in what is left
MASK_CLEAR = 0.5
MASK_NOISE = 0.01  # share of greys that JPEG makes beside edges at most
# Share of flat pixels in regions of ids; soft edges of the fox have .02, its ids .97
MASK_FLAT = 0.3
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
        shown = pixels.ids if pixels.alpha is None else pixels.ids * (pixels.alpha >= MASK_HALF)
        return torch.from_numpy(shown)
    levels = pixels.alpha if reading == "alpha" else pixels.levels
    if levels is None:
        what = "opacity" if reading == "alpha" else "greys"
        raise StyleSplatError(
            f"Cannot read the mask {path}: it has no {what}, as others in its folder have. Make "
            "all of them in one way."
        )
    return torch.from_numpy((levels >= MASK_HALF).astype(np.int32))


def find_reading(paths: Sequence[Path]) -> tuple[Reading | None, str]:
    """What the pixels of a folder's pictures mean, if ids or masks, and why, for users."""
    sample = evenly_spaced(paths, MASK_SAMPLED)
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
        opaque = (
            np.ones_like(pixels.ids, bool) if pixels.alpha is None else pixels.alpha >= MASK_HALF
        )
        own = opaque & (pixels.ids != 0)
        colors = len(np.unique(pixels.ids[own]))
        is_flat = (own & _is_flat(pixels.ids)).sum() >= MASK_FLAT * own.sum()
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
    stray = MASK_NOISE * size if any(look.lossy for look in looks) else 0
    is_edge = edge >= MASK_CLEAR * between or between <= stray
    return clear >= MASK_CLEAR * size and flat <= MASK_FLAT * between and is_edge


def _is_flat(ids: Integer[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Which pixels have a neighbour of their value beside them, and one above or below."""
    below, beside = (np.diff(ids, axis=axis) == 0 for axis in (0, 1))
    vertical = np.pad(below, ((1, 0), (0, 0))) | np.pad(below, ((0, 1), (0, 0)))
    return vertical & (np.pad(beside, ((0, 0), (1, 0))) | np.pad(beside, ((0, 0), (0, 1))))


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

"""The photos of a folder: their files, EXIF data and cameras, and which are fit to be posed."""

import importlib.util
import os
import re
import shutil
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
import torch
from PIL import ExifTags, Image

from stylesplat.errors import StyleSplatError, count_noun, join_names, shorten
from stylesplat.io.atomic import PARTIAL, atomic_path
from stylesplat.io.captures.photos import BLACK, SmallPhoto, plain_suffix, read_small
from stylesplat.io.captures.posed_files import check_path
from stylesplat.io.files import reason, resolve_within
from stylesplat.io.images import (
    decode,
    exif_of,
    flatten_alpha,
    open_image,
    read_image,
    straight_alpha,
    write_image,
)
from stylesplat.io.json_yaml import PhotoName
from stylesplat.io.kinds import HEIC, NO_PHOTOS, PHOTOS, VIDEOS, find_poses
from stylesplat.progress import track
from stylesplat.structure_from_motion.config import MIN_PHOTOS
from stylesplat.structure_from_motion.image_measures import (
    ALL_BLURRED,
    BLURRED,
    MEASURE_SIDE,
    lacks_background,
    near_duplicates,
    relative_sharpness,
    shares_backdrop,
    sharpness,
)
from stylesplat.structure_from_motion.turntable import find_turntable

T = TypeVar("T")
Result = TypeVar("Result")

DECODERS = 2  # threads; each needs 100 MB for a photo of 12 megapixels

Base = ExifTags.Base
# Tags that COLMAP reads the focal length from, and that identify the camera. GPS tags are dropped
CAMERA_TAGS = (Base.Make, Base.Model)
LENS_TAGS = (Base.FocalLength, Base.FocalLengthIn35mmFilm, Base.LensModel)
SENSOR_TAGS = Base.FocalPlaneXResolution, Base.FocalPlaneYResolution, Base.FocalPlaneResolutionUnit
CUT_OUT_SUFFIX = ".png"  # of photos written with their transparency
SOME_TRANSPARENT = 0.001  # share of a photo's pixels, up to which it is no cut-out
MAX_TEXT = 64  # characters of a camera's name
MAX_NUMBER = 1e6  # millimetres or pixels in an inch: no camera has as many


def group_by_camera(photos: Path, names: Sequence[str], cameras: str) -> list[list[int]]:
    """Rows of photos by size and lens, reading headers only."""
    rows: dict[tuple[object, ...], list[int]] = {}
    for row, name in enumerate(names):
        with open_image(resolve_within(photos, name)) as image:
            key: tuple[object, ...] = image.size
            if cameras == "several":
                key = (row,)
            elif cameras == "auto":
                exif = exif_of(image)
                details = exif.get_ifd(ExifTags.IFD.Exif)
                lens = (str(details.get(tag)) for tag in LENS_TAGS)
                key = (*key, str(exif.get(Base.Model)), *lens)
        rows.setdefault(key, []).append(row)
    return [*rows.values()]


def lens_exif(path: Path) -> bytes:
    """EXIF data with the camera and its lens alone; empty if unknown or damaged."""
    with open_image(path) as image:
        try:
            found, kept = exif_of(image), Image.Exif()
            details, kept_details = (e.get_ifd(ExifTags.IFD.Exif) for e in (found, kept))
            kept.update({t: found[t] for t in CAMERA_TAGS if _is_plausible(found.get(t))})
            tags = (*LENS_TAGS, *SENSOR_TAGS)
            kept_details.update({t: details[t] for t in tags if _is_plausible(details.get(t))})
            return kept.tobytes() if kept or kept_details else b""
        except Exception:  # Pillow raises all kinds
            return b""


def _is_plausible(value: object) -> bool:
    if isinstance(value, str):
        return 0 < len(value) <= MAX_TEXT and value.isascii() and value.isprintable()
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return False
    return 0 < number <= MAX_NUMBER


def color_profile(path: Path) -> bytes | None:
    with open_image(path) as image:
        return image.info.get("icc_profile") if image.mode in ("RGB", "RGBA") else None


def write_photo(source: Path, target: Path) -> None:
    """Copy an upright 8-bit JPEG or PNG; write others upright, cut-outs as PNG, else as JPEG."""
    if plain_suffix(source):
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
        return
    exif, profile = lens_exif(source), color_profile(source)
    if target.suffix.lower() == CUT_OUT_SUFFIX:
        pixels = straight_alpha(flatten_alpha(decode(source, upright=True), BLACK))
        write_image(torch.from_numpy(pixels), target, exif=exif, icc_profile=profile)
    else:
        write_image(read_image(source), target, exif=exif, icc_profile=profile)


def map_photos(
    work: Callable[[T], Result], items: Collection[T], what: str, *, threads: int = DECODERS
) -> list[Result]:
    """Apply a function to photos in threads, with a progress bar; results are in order."""
    # Warning filters belong to the process: threads that change them would mix them up
    with warnings.catch_warnings(action="ignore"), ThreadPoolExecutor(threads) as pool:
        try:
            return [*track(pool.map(work, items), what, total=len(items), unit="photo")]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".pef", ".srw")
# Share of photos that show a backdrop's edge. With more, nobody masked the others, which it fills
# (.3 of Middlebury's temple ring); with fewer, those with the edge are left out
MAX_STRAYS = 0.25
MAX_MASKED = 0.5  # share of photos without background; with more the user masked them on purpose
# Numbers from the first to the last photo, per photo; with more it is no series
PHOTO_MAX_NUMBERS = 4


@dataclass(frozen=True)
class SourceFiles:
    photos: tuple[str, ...]
    """Paths within the folder, in natural order, with `/` between the parts."""
    videos: tuple[str, ...]
    left_out: dict[str, str]
    """By path of a photo that cannot be used, the reason."""


@dataclass(frozen=True)
class PreparedPhotos:
    """Upright photos in one folder, and which photos were left out."""

    names: tuple[PhotoName, ...]
    """Paths relative to the folder, with `/` between the parts, in order."""
    ordered: bool
    """Whether neighbours in the list were neighbours in time: a video, or numbered frames."""
    origins: Mapping[PhotoName, str]
    """By name what the user calls it: a path in their folder, or a frame and its time."""
    sharpness: Mapping[PhotoName, float]
    """By name, relative to what is typical among its neighbours: 1 is typical, less is blurred."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """By the user's own name why a photo was left out, in a few words."""
    cut_outs: bool = False
    """Whether their backgrounds are transparent or of one colour."""


def find_sources(folder: Path, *, skip: Path) -> SourceFiles:
    """Find the photos and videos in a folder and below, without hidden files and our own output."""
    _refuse_posed(folder)
    names = sorted(_walk(folder, skip), key=natural_key)
    left_out = {name: fault for name in names if (fault := _unusable_file(name))}
    usable = [name for name in names if name not in left_out]
    photos, videos = (tuple(n for n in usable if n.lower().endswith(k)) for k in (PHOTOS, VIDEOS))
    heic = [name for name in photos if name.lower().endswith(HEIC)]
    if heic and importlib.util.find_spec("pillow_heif") is None:
        raise StyleSplatError(
            f"{shorten(heic[0])} is HEIC, as are {len(heic)} of {len(photos)} photos of {folder}. "
            "`pip install 'stylesplat[heic]'` makes them readable."
        )
    return SourceFiles(photos, videos, left_out)


def _refuse_posed(folder: Path) -> None:
    found = find_poses(folder)
    if found:
        posed = join_names(path.relative_to(folder).as_posix() for path in found[0].paths)
        photos = f", or give {folder / 'images'} to find new ones" * (folder / "images").is_dir()
        raise StyleSplatError(
            f"{folder} has its poses already ({posed}). Use it as it is, with "
            f"`stylesplat train {folder}`{photos}."
        )


def _walk(folder: Path, skip: Path) -> Iterator[str]:
    ours = skip.resolve()

    def fail(error: OSError) -> None:
        raise StyleSplatError(f"Cannot read {error.filename}: {error.strerror}.") from error

    for place, folders, files in os.walk(folder, onerror=fail):
        here = Path(place)
        folders[:] = [f for f in folders if not _is_skipped(f) and (here / f).resolve() != ours]
        inside = [here / file for file in files if not _is_skipped(file)]
        yield from (path.relative_to(folder).as_posix() for path in inside if path.is_file())


def _is_skipped(name: str) -> bool:
    hidden = name.startswith((".", "__MACOSX", "@eaDir"))
    return hidden or name.endswith(PARTIAL) or name.casefold() in NO_PHOTOS


def _unusable_file(name: str) -> str | None:
    if name.lower().endswith(RAW):
        return "a raw file; give JPEG"
    if not name.lower().endswith(PHOTOS):
        return None
    try:
        check_path(name)
    except StyleSplatError:
        return "other programs cannot read its name; rename it"
    return None


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """A sort key by which numbers in names sort as numbers.

    Example:
        >>> sorted(["b10.jpg", "b9.jpg", "B1.JPG"], key=natural_key)
        ['B1.JPG', 'b9.jpg', 'b10.jpg']
    """
    parts = re.split(r"(\d+)", name.casefold())
    keys = [(0, int(p)) if i % 2 else (1, p) for i, p in enumerate(parts) if p]
    return (*keys, (1, name))


def is_series(names: Sequence[str]) -> bool:
    """Whether names in order differ by a running number only, with few gaps.

    Example:
        >>> is_series(["IMG_8.jpg", "IMG_9.jpg", "IMG_12.JPG"]), is_series(["a1.jpg", "b2.jpg"])
        (True, False)
    """
    stems = [PurePosixPath(name).with_suffix("").as_posix().casefold() for name in names]
    matches = [match for stem in stems if (match := re.fullmatch(r"(.*?)(\d+)\D*", stem))]
    if len(matches) < len(names) or len({match[1] for match in matches}) != 1:
        return False
    numbers = [int(match[2]) for match in matches]
    return numbers[-1] - numbers[0] < PHOTO_MAX_NUMBERS * len(numbers)


@dataclass(frozen=True, eq=False)
class _Candidate:
    name: str
    small: SmallPhoto = field(repr=False)
    sharpness: float
    suffix: str
    """Of the file that will be written."""


def select_photos(source: Path, files: SourceFiles) -> PreparedPhotos:
    """Leave out the photos of a folder that are unreadable, blurred or near duplicates, and those
    with a background if most have none, or the other way round.
    """
    left_out = {**files.left_out, **dict.fromkeys(files.videos, "a video among photos")}
    photos = _measure(source, files.photos, left_out)
    masked = {photo.name for photo in photos if lacks_background(photo.small)}
    rooms = [photo.small for photo in photos if photo.name not in masked]
    if len(rooms) > MAX_STRAYS * len(photos):
        masked -= {p.name for p in photos if p.name in masked and shares_backdrop(p.small, rooms)}
    if cut_outs := len(masked) > MAX_MASKED * len(photos):
        others = {photo.name for photo in photos} - masked
        left_out |= dict.fromkeys(others, "it has a background, which most photos lack")
    else:
        left_out |= dict.fromkeys(masked, "its background is transparent or of one colour")
    photos = [photo for photo in photos if photo.name not in left_out]
    series = is_series([photo.name for photo in photos])
    measured = [photo.sharpness for photo in photos]
    if len(photos) >= MIN_PHOTOS and np.median(measured) < ALL_BLURRED:
        raise StyleSplatError(
            f"The photos of {source} are all blurred. Hold the camera still for each photo, in "
            "more light, and let it focus."
        )
    sharp = {p.name: value for p, value in zip(photos, relative_sharpness(measured), strict=True)}
    left_out |= {name: "blurred" for name, value in sharp.items() if value < BLURRED}
    photos = [photo for photo in photos if photo.name not in left_out]
    repeats = dict[int, int]()
    if find_turntable(source, [photo.name for photo in photos]) is None:  # else the room repeats
        worth = [(float(np.prod(photo.small.size)), sharp[photo.name]) for photo in photos]
        repeats = near_duplicates([photo.small.grey for photo in photos], worth)
    for row, kept in sorted(repeats.items()):
        left_out[photos[row].name] = f"nearly the same as {photos[kept].name}"
    photos = [photo for row, photo in enumerate(photos) if row not in repeats]
    if len(photos) < MIN_PHOTOS:
        raise too_few_photos(source, len(photos), left_out)
    written = dict(zip(_written_names(photos), photos, strict=True))
    return PreparedPhotos(
        names=tuple(written),
        ordered=series,
        origins={name: photo.name for name, photo in written.items()},
        sharpness={name: sharp[photo.name] for name, photo in written.items()},
        left_out=left_out,
        cut_outs=cut_outs,
    )


def too_few_photos(source: Path, usable: int, left_out: Mapping[str, str]) -> StyleSplatError:
    reasons = join_names(
        (f"{shorten(name)} ({text})" for name, text in left_out.items()), whole=True
    )
    others = f"; {len(left_out)} left out: {reasons}" if reasons else ""
    usable_photos = count_noun(usable, "photo") if usable else "no photos"
    return StyleSplatError(
        f"{source} has {usable_photos} that can be used{others}. "
        f"Give {MIN_PHOTOS} at least, better 30 or more, that overlap."
    )


def _measure(source: Path, names: Sequence[str], left_out: dict[str, str]) -> list[_Candidate]:
    def measure(name: str) -> _Candidate | str:
        path = source / name
        try:
            small = read_small(path, MEASURE_SIDE)
            suffix = plain_suffix(path) or ".jpg"
            if small.transparent > SOME_TRANSPARENT:
                suffix = CUT_OUT_SUFFIX
            return _Candidate(name, small, sharpness(small.grey), suffix)
        except StyleSplatError as error:
            cause = error.__cause__ if isinstance(error.__cause__, Exception) else error
            return f"no readable picture: {reason(cause)}"

    found = map_photos(measure, names, "measuring photos")
    left_out.update({n: why for n, why in zip(names, found, strict=True) if isinstance(why, str)})
    return [photo for photo in found if isinstance(photo, _Candidate)]


def _written_names(photos: Sequence[_Candidate]) -> Iterator[str]:
    """The names of the written photos: their own, with the suffix of what is written.

    Label maps are named like photos without suffix, so names differ without it, and also where
    case is lost.
    """
    taken: set[str] = set()
    for photo in photos:
        own = PurePosixPath(photo.name).suffix
        stem = photo.name.removesuffix(own)
        same_kind = own.lower() in (photo.suffix, photo.suffix.replace("jpg", "jpeg"))
        numbered = (f"{stem}_{number}" for number in count(2))
        choices = chain((stem, f"{stem}_{own[1:].lower()}"), numbered)
        free = next(choice for choice in choices if choice.casefold() not in taken)
        taken.add(free.casefold())
        yield free + (own if same_kind else photo.suffix)

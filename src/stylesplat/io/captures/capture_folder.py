"""Captures on disk: posed photos, their label maps, their sparse points and how they were made."""

import math
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import compress
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import torch
from jaxtyping import Int, UInt8
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, join_names, noun_repr
from stylesplat.io.captures.colmap import read_colmap
from stylesplat.io.captures.lens import LENS_MAX_SIDE, Lens
from stylesplat.io.captures.llff import read_llff
from stylesplat.io.captures.photo_names import photo_files, photo_places
from stylesplat.io.captures.photos import PHOTO_OPAQUE, Photo, check_masks, fit_photo, valid_pixels
from stylesplat.io.captures.posed_files import (
    PosedFiles,
    drop_bad_points,
    drop_bad_poses,
    drop_missing,
    split_offset,
)
from stylesplat.io.captures.transforms import read_transforms
from stylesplat.io.json_yaml import FilePath, read_json_as, write_json
from stylesplat.io.kinds import find_poses, wrong_kind_error
from stylesplat.io.label_maps import FoundMasks, fitted_maps, match_label_maps
from stylesplat.options import check_arguments
from stylesplat.progress import say, track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.sequences import Cache, Lazy, evenly_spaced
from stylesplat.scene.world_offset import ORIGIN, announced

SFM_FILE = "sfm.json"
SFM_FORMAT = 1
MAX_PHOTOS = 1_000_000
MAX_PARAMS = 32  # of a lens; COLMAP's models have 16 at most
OneLine = Annotated[str, Meta(max_length=4096, pattern=r"\A[^\x00-\x1f\x7f]*\Z")]  # in one line
Reasons = Annotated[dict[OneLine, OneLine], Meta(max_length=MAX_PHOTOS)]
Count = Annotated[int, Meta(ge=0, le=MAX_PHOTOS)]


class TakenLens(msgspec.Struct):
    """A lens of photos before they were undistorted, by COLMAP's names."""

    model: OneLine
    width: Annotated[int, Meta(ge=1, le=LENS_MAX_SIDE)]
    height: Annotated[int, Meta(ge=1, le=LENS_MAX_SIDE)]
    params: Annotated[list[float], Meta(max_length=MAX_PARAMS)]
    photos: Annotated[list[OneLine], Meta(max_length=MAX_PHOTOS)]
    """Their names in the capture."""


class SfmRecord(msgspec.Struct, kw_only=True):
    format: Annotated[int, Meta(ge=1, le=SFM_FORMAT)] = SFM_FORMAT
    source: FilePath
    """The folder of photos, or the video."""
    digest: OneLine
    """Hash of the names and sizes of its files."""
    given: Count
    """Number of photos in the source, or of frames taken from the video."""
    registered: Count
    left_out: Reasons
    """Why a photo was not tried, by the user's name of it."""
    unregistered: Reasons
    """Why a photo that was tried has no pose, by the user's name of it."""
    origins: Reasons
    """The user's name of a photo by its name in the capture, where the two differ."""
    frame: dict[str, Any]
    """The world's axes, origin and unit."""
    settings: dict[str, Any]
    numbers: dict[str, Any]
    libraries: dict[str, OneLine]
    lenses: Annotated[list[TakenLens], Meta(max_length=MAX_PHOTOS)] = []
    """Those of all photos with a pose; older versions wrote none."""
    turns: bool = False
    """Whether the poses are those of what turned before a room that stood still."""

    def __repr__(self) -> str:
        found = f"{self.registered:,} of {count_noun(self.given, 'photo')} with a pose"
        return noun_repr(self, found, self.source)


def read_sfm(folder: Path) -> SfmRecord | None:
    """Read how the poses of a capture were found; None if they are not from `sfm`."""
    path = folder / SFM_FILE
    if not path.is_file():
        return None
    return read_json_as(path, SfmRecord, "Delete it, or pose the photos again.")


def write_sfm(record: SfmRecord, folder: Path) -> None:
    write_json(msgspec.to_builtins(record), folder / SFM_FILE)


OBJECT_MASK = "object_mask"  # the folder of label maps inside a capture
CAPTURE_EXACT = "object_mask_exact"  # label maps to measure with, where the others contain mistakes
CUT_OUT_SAMPLE = 5  # photos with an alpha channel that are decoded: most channels are opaque
CUT_OUT_NAMES = {1: "object"}  # what a cut-out shows, by label id
CACHE_BYTES = 2**27  # the photo decoded last, so that its colours and alpha are decoded once

MaskFolder = Path | str | Literal[False] | None


@dataclass(frozen=True, eq=False)
class CaptureFiles:
    """A capture whose headers are read, to be opened at one size or several."""

    whole: Capture
    """At full size, without what masks and cut-outs say."""
    photos: list[Photo]
    """At full size."""
    masks: Path | Literal[False] | None
    """The folder of label maps; False if none are wanted."""
    cut_out: bool
    """Whether the photos are transparent around the object."""
    valid_masks: Sequence[Path | None] | None
    """The files of the photos' masks, 0 where pixels are not to be used."""

    def at(self, downscale: float | int) -> Capture:
        """The capture with photos, label maps and cameras that are `downscale` times smaller."""
        if not 1 <= downscale < math.inf:
            raise StyleSplatError(f"Cannot downscale by {downscale}. Give a factor of 1 or more.")
        cameras = self.whole.cameras.downscale(downscale)
        sizes = cameras.sizes.tolist()
        files = [photo.resized(*size) for photo, size in zip(self.photos, sizes, strict=True)]
        photos, alphas = Lazy([file.read for file in files]), None
        if self.cut_out:
            photos, alphas = _split_alpha(files)
        label_maps, names = None, {}
        if self.masks:
            drawn_on = _with_taken_lenses(files, cameras.names, self.whole.path)
            label_maps = fitted_maps(self._found_masks, cameras.names, drawn_on)
            names = self._found_masks.names
        elif alphas is not None and self.masks is None:
            label_maps, names = _opaque_maps(alphas), CUT_OUT_NAMES
        return replace(
            self.whole,
            cameras=cameras,
            photos=photos,
            label_maps=label_maps,
            object_names=names,
            alphas=alphas,
            valid_masks=None if self.valid_masks is None else valid_pixels(self.valid_masks, files),
            full=self.whole.cameras,
            downscale=float(downscale),
        )

    @cached_property
    def _found_masks(self) -> FoundMasks:
        assert self.masks
        return match_label_maps(self.masks, self.whole.cameras.names)


def open_capture(path: Path | str, *, masks: MaskFolder = None) -> CaptureFiles:
    """Read the headers of a capture; `masks` is described at `load`."""
    folder = Path(path)
    posed = drop_bad_points(drop_bad_poses(_read_poses(folder), folder), folder)
    posed, offset = split_offset(posed)
    if offset != ORIGIN:
        say(announced(folder, offset))
    others = photos_besides(folder, posed.names)
    if others:
        count = len(others) + len(posed.names) + len(posed.missing)
        say(
            f"Without a pose, so left out: {join_names(others)} "
            f"({len(others)} of the {count} photos in {folder})."
        )
    posed = drop_missing(posed, folder)
    lenses = [lens for lens in posed.lenses if lens is not None]  # every existing photo has one
    pairs = [*zip(posed.paths, lenses, strict=True)]
    photos = [fit_photo(*pair) for pair in track(pairs, "reading photos", unit="photo")]
    if posed.masks is not None:
        check_masks(posed.masks, photos)
    stored = [name for name, photo in zip(posed.names, photos, strict=True) if photo.as_stored]
    if stored:
        say(
            f"Used as stored, not as their EXIF rotation shows them: {join_names(stored)} "
            f"({len(stored)} of the {len(photos)} photos in {folder}). Poses, boxes and label maps "
            "belong to the stored pixels."
        )
    pinholes = [photo.lens.pinhole() for photo in photos]
    cameras = Cameras(
        viewmats=posed.viewmats.float(),
        Ks=torch.stack([pinhole.K for pinhole in pinholes]),
        sizes=torch.tensor([pinhole.size for pinhole in pinholes]),
        names=posed.names,
    )
    whole = Capture(
        cameras=cameras,
        photos=Lazy([photo.read for photo in photos]),
        points=posed.points,
        point_colors=posed.point_colors,
        path=folder,
        held_out=posed.held_out,
        world_offset=offset,
    ).without_outliers()
    near = [row not in whole.outliers.rows for row in range(len(photos))]
    photos = [*compress(photos, near)]
    if masks is None and (folder / OBJECT_MASK).is_dir():
        masks = folder / OBJECT_MASK
    with_alpha = evenly_spaced([photo for photo in photos if photo.has_alpha()], CUT_OUT_SAMPLE)
    return CaptureFiles(
        whole=whole,
        photos=photos,
        masks=masks if masks is None or masks is False else Path(masks),
        cut_out=any(photo.is_cut_out() for photo in with_alpha),
        valid_masks=None if posed.masks is None else [*compress(posed.masks, near)],
    )


def _with_taken_lenses(
    photos: Sequence[Photo], names: Sequence[str], folder: Path | None
) -> list[Photo]:
    """Photos with the lenses that they had before `sfm` undistorted them, where these are known."""
    record, taken = None if folder is None else read_sfm(folder), dict[str, Lens]()
    for each in [] if record is None else record.lenses:
        lens = Lens.create(each.model, each.width, each.height, each.params)
        taken |= dict.fromkeys(each.photos, lens)
    return [
        replace(photo, taken=lens) if lens and lens.pinhole().size == photo.lens.size else photo
        for photo, lens in zip(photos, map(taken.get, names), strict=True)
    ]


def _read_poses(folder: Path) -> PosedFiles:
    """The poses of a capture; a message names those that are there in other forms or places."""
    found = find_poses(folder)
    if not found:
        raise wrong_kind_error(folder, "capture")
    used, *others = (
        (poses, join_names(path.relative_to(folder).as_posix() for path in poses.paths))
        for poses in found
    )
    if others:
        unused = ", ".join(paths for _, paths in others)
        say(f"{folder} has poses in several places: those in {used[1]} are used, not {unused}.")
    match used[0].form:
        case "colmap":
            return read_colmap(folder, used[0].paths)
        case "transforms":
            return read_transforms(folder)
        case "llff":
            return read_llff(folder)


def exact_masks(folder: Path) -> Path | None:
    """The label maps of a capture to measure with, if it has some; a message says so."""
    if not (folder / CAPTURE_EXACT).is_dir():
        return None
    say(f"Objects are compared with {folder / CAPTURE_EXACT}, the exact label maps.")
    return folder / CAPTURE_EXACT


def unposed_photos(folder: Path, posed: Collection[str]) -> tuple[dict[str, str], int]:
    """The photos without a pose and why, as `sfm` wrote down, and how many were not tried."""
    record = read_sfm(folder)
    if record is not None:
        return dict(record.unregistered), len(record.left_out)
    return dict.fromkeys(photos_besides(folder, posed), ""), 0


def photos_besides(folder: Path, posed: Collection[str]) -> list[str]:
    """The names of the other photos in the folder of a capture's posed photos, sorted."""
    places = [*photo_places(folder), *(path for path in sorted(folder.iterdir()) if path.is_dir())]
    counts = {place: sum(os.path.lexists(place / name) for name in posed) for place in places}
    place = max(counts, key=lambda each: counts[each])
    if not counts[place]:  # those of transforms.json may lie anywhere
        return []
    others = [name for name in photo_files(place) if name not in {*posed}]
    if place == folder:  # which holds other pictures as well
        parents = {Path(name).parent for name in posed}
        others = [name for name in others if Path(name).parent in parents]
    return others


def with_drawn_maps(capture: Capture, found: FoundMasks) -> Capture:
    """A capture with label maps that were drawn on its photos as they were taken, at any size."""
    label_maps = fitted_maps(found, capture.cameras.names, _photos_of(capture))
    return replace(capture, label_maps=label_maps, object_names=dict(found.names))


def _photos_of(capture: Capture) -> list[Photo]:
    """The photos with their lenses; those of a capture in memory have pinholes."""
    cameras, sizes = capture.cameras, capture.cameras.sizes.tolist()
    if capture.path is not None:
        files = open_capture(capture.path, masks=False)
        photos = (files.photos[files.whole.cameras.index(name)] for name in cameras.names)
        photos = [photo.resized(*size) for photo, size in zip(photos, sizes, strict=True)]
        return _with_taken_lenses(photos, cameras.names, capture.path)
    return [
        Photo(Path(name), True, Lens("PINHOLE", w, h, (fx, fy, cx, cy)), (w, h))
        for name, ((fx, _, cx), (_, fy, cy), _), (w, h) in zip(
            cameras.names, cameras.Ks.tolist(), sizes, strict=True
        )
    ]


def _split_alpha(
    photos: Sequence[Photo],
) -> tuple[Lazy[UInt8[Tensor, "H W 3"]], Lazy[UInt8[Tensor, "H W"] | None]]:
    """Colours over black and alphas of photos, decoded on access."""
    recent: Cache[int] = Cache(CACHE_BYTES)

    def pixels(row: int) -> UInt8[Tensor, "H W D"]:
        return recent.get(row, lambda: (photos[row].read_with_alpha(),))[0]

    def alpha(row: int) -> UInt8[Tensor, "H W"] | None:
        both = pixels(row)
        return both[..., 3].contiguous() if both.shape[-1] > 3 else None

    rows = range(len(photos))
    colors = [lambda row=row: pixels(row)[..., :3].contiguous() for row in rows]
    return Lazy(colors), Lazy([partial(alpha, row) for row in rows])


def _opaque_maps(alphas: Lazy[UInt8[Tensor, "H W"] | None]) -> Lazy[Int[Tensor, "H W"] | None]:
    """Label maps that are 1 where photos are opaque; None where a photo has no alpha."""

    def labels(row: int) -> Int[Tensor, "H W"] | None:
        alpha = alphas[row]
        return None if alpha is None else (alpha >= PHOTO_OPAQUE).int()

    return Lazy([partial(labels, row) for row in range(len(alphas))])


@check_arguments
def load(path: Path | str, *, downscale: float = 1.0, masks: MaskFolder = None) -> Capture:
    """Read a capture: photos with a COLMAP reconstruction, `transforms.json`, or LLFF's poses.

    Only the headers of the photos are read now; photos are decoded and undistorted on each access.
    The world frame is that of the files. Photos that the files hold out (`transforms_test.json`,
    `test_filenames`) become `held_out`, and their masks (`mask_path`) `valid_masks`. If photos are
    cut out (a few with an alpha channel are decoded to find out), the opaque part is an object
    called `object`, unless there are label maps.

    Args:
        path: The capture's folder.
        downscale: Factor by which photos, label maps and cameras are made smaller.
        masks: The folder of label maps; by default the capture's `object_mask/` if it has one.
            False ignores label maps, and the object of cut-out photos too.

    Raises:
        StyleSplatError: If the folder is no capture, or a file of it is missing or damaged or
            does not fit the others.
    """
    return open_capture(path, masks=masks).at(downscale)

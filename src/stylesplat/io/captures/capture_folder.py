"""From a folder to a capture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, some
from stylesplat.io.captures import cut_outs
from stylesplat.io.captures.colmap import find_sparse, read_colmap
from stylesplat.io.captures.decoding import MAX_PIXELS
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import Photo, fit_photo, is_reduced
from stylesplat.io.captures.posed_files import PosedFiles, those_there
from stylesplat.io.captures.transforms import TRANSFORMS, read_transforms
from stylesplat.io.captures.unposed import photos_besides
from stylesplat.io.files import is_file
from stylesplat.io.kinds import no_capture
from stylesplat.io.label_maps import match_label_maps, read_names
from stylesplat.progress import say, track
from stylesplat.scene.cache import Lazy
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.poses import are_rigid

OBJECT_MASK = "object_mask"  # the folder of label maps inside a capture
EXACT = "object_mask_exact"  # that of those to measure with, where the others have mistakes


@dataclass(frozen=True)
class CaptureFiles:
    """A capture on disk whose headers are read, to be taken at one size or several."""

    path: Path
    """Its folder."""
    cameras: Cameras
    """One per photo, at full size."""
    photos: list[Photo]
    """At full size."""
    masks: Path | Literal[False] | None
    """The folder of label maps; False if none are wanted."""
    points: Float[Tensor, "M 3"] | None
    """Sparse points in the world."""
    point_colors: UInt8[Tensor, "M 3"] | None
    """Colours of `points`."""
    cut_out: bool
    """Whether the photos are transparent where the object is not."""

    def at(self, downscale: float | int) -> Capture:
        """The capture with photos, label maps and cameras so many times smaller.

        Raises:
            StyleSplatError: If the factor is less than 1, or a label map is damaged or does not
                fit its photo.
        """
        if not 1 <= downscale < math.inf:
            raise StyleSplatError(f"Cannot downscale by {downscale}. Give a factor of 1 or more.")
        cameras = self.cameras.downscale(downscale)
        sizes = cameras.sizes.tolist()
        files = [photo.resized(*size) for photo, size in zip(self.photos, sizes, strict=True)]
        photos, alphas = Lazy([file.read for file in files]), None
        if self.cut_out:
            photos, alphas = cut_outs.split_alpha(files)
        label_maps, names = None, {}
        if self.masks:
            label_maps = match_label_maps(self.masks, cameras.names, files)
            names = read_names(self.masks)
        elif alphas is not None and self.masks is None:
            label_maps, names = cut_outs.object_maps(alphas), cut_outs.NAMES
        return Capture(
            cameras=cameras,
            photos=photos,
            label_maps=label_maps,
            points=self.points,
            point_colors=self.point_colors,
            path=self.path,
            object_names=names,
            alphas=alphas,
            full=self.cameras,
            downscale=float(downscale),
        )


Masks = Path | str | Literal[False] | None


def open_capture(path: Path | str, *, masks: Masks = None) -> CaptureFiles:
    """Read the headers of a capture, for whoever needs it at more than one size.

    Raises:
        StyleSplatError: If the folder is no capture, or a file of it is missing or damaged or
            does not fit the others.
    """
    folder = Path(path)
    posed = _read_poses(folder)
    _check_poses(posed, folder)
    _announce_unposed(posed, folder)
    posed = those_there(posed, folder)
    lenses = [lens for lens in posed.lenses if lens is not None]  # photos that are there have one
    pairs = [*zip(posed.paths, lenses, strict=True)]
    photos = [fit_photo(*each) for each in track(pairs, "reading photos", unit="photo")]
    _announce_reduced(photos, lenses)
    pinholes = [photo.lens.pinhole() for photo in photos]
    cameras = Cameras(
        viewmats=posed.viewmats.float(),
        Ks=torch.stack([pinhole.K for pinhole in pinholes]),
        sizes=torch.tensor([pinhole.size for pinhole in pinholes]),
        names=posed.names,
    )
    if masks is None and (folder / OBJECT_MASK).is_dir():
        masks = folder / OBJECT_MASK
    return CaptureFiles(
        path=folder,
        cameras=cameras,
        photos=photos,
        masks=masks if masks is None or masks is False else Path(masks),
        points=posed.points,
        point_colors=posed.point_colors,
        cut_out=cut_outs.are_cut_out(photos),
    )


def is_posed(folder: Path) -> bool:
    """Whether a folder has camera poses."""
    return find_sparse(folder) is not None or is_file(folder / TRANSFORMS)


def exact_masks(folder: Path) -> Path | None:
    """The label maps that a capture has to measure with, besides those to train on; says so."""
    if not (folder / EXACT).is_dir():
        return None
    say(f"Objects are compared with {folder / EXACT}, the exact label maps.")
    return folder / EXACT


def _read_poses(folder: Path) -> PosedFiles:
    sparse = find_sparse(folder)
    if sparse:
        return read_colmap(folder, sparse)
    if (folder / TRANSFORMS).is_file():
        return read_transforms(folder)
    raise no_capture(folder)


def _check_poses(posed: PosedFiles, folder: Path) -> None:
    rigid = are_rigid(posed.viewmats).tolist()
    bad = [name for name, fits in zip(posed.names, rigid, strict=True) if not fits]
    if bad:
        raise StyleSplatError(
            f"{len(bad)} of the {len(posed.names)} poses in {folder} are NaN or no rotation and "
            f"shift, the first that of {bad[0]}. Pose the photos again."
        )
    if posed.points is not None and not posed.points.isfinite().all():
        raise StyleSplatError(
            f"Some points in {folder} are NaN or infinitely far. Pose the photos again."
        )


def _announce_unposed(posed: PosedFiles, folder: Path) -> None:
    others = photos_besides(folder, posed.names)
    if others:
        total = len(others) + len(posed.names)
        say(
            f"Without a pose, so left out: {some(others)} "
            f"({len(others)} of the {total} photos in {folder})."
        )


def _announce_reduced(photos: Sequence[Photo], lenses: Sequence[Lens]) -> None:
    pairs = zip(photos, lenses, strict=True)
    smaller = [photo.path for photo, lens in pairs if photo.lens.size != lens.size]
    reduced = [path for path in smaller if is_reduced(path)]
    if reduced:
        say(
            f"{len(reduced)} photos have more than {MAX_PIXELS // 10**6} megapixels, such as "
            f"{reduced[0]}: they are read at half their width and height, which boxes and points "
            "go by."
        )

"""The `Capture` noun: posed photos, with label maps if there are any; resized, fingerprinted."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from itertools import chain
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, join_names, noun_repr
from stylesplat.photo_libraries import cv2
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras, pixels
from stylesplat.scene.outliers import Outliers, find_outliers
from stylesplat.scene.sequences import GIB, Cache, Lazy, evenly_spaced
from stylesplat.scene.world_offset import ORIGIN, Offset

BACKGROUND = 0  # the label id that means 'no object'
FEW_IDS = 2**16  # ids below which counting them is faster than sorting the pixels
ALL = 0.999  # share of a pixel that counts as all of it, as sums are rounded
MAX_ID = 2**24 - 1  # what three bytes hold, as in RGB-coded label maps

Mask = Bool[Tensor, "H W"]
Labels = Int[Tensor, "H W"]
OwnLabels = Int[Tensor, "_ _"]  # one of several label maps, which may differ in size


def ids_of(labels: OwnLabels | None) -> set[int]:
    """The ids that occur in a label map, background included; none if there is no map."""
    if labels is None or labels.numel() == 0:
        return set()
    if 0 <= int(labels.min()) and int(labels.max()) < FEW_IDS:
        return {*labels.flatten().bincount().nonzero()[:, 0].tolist()}
    return {*labels.unique().tolist()}


def resize_labels(labels: Shaped[Tensor, "H W"], size: Sequence[int]) -> Shaped[Tensor, "h w"]:
    if tuple(labels.shape) == tuple(size):
        return labels
    y, x = (
        ((torch.arange(new) + 0.5) * old / new).long()
        for new, old in zip(size, labels.shape, strict=True)
    )
    return labels[y[:, None].to(labels.device), x.to(labels.device)]


def shrink_mask(mask: Bool[Tensor, "H W"], size: Sequence[int]) -> Bool[Tensor, "h w"]:
    """A smaller mask, true where all that a pixel covers is."""
    if tuple(mask.shape) == tuple(size):
        return mask
    levels = mask.cpu().to(torch.float32).numpy()
    return torch.from_numpy(cv2.resize(levels, size[::-1], interpolation=cv2.INTER_AREA) > ALL)


@dataclass(frozen=True, eq=False)
class Capture:
    """Posed photos, which may differ in size. All sequences may load on access."""

    cameras: Cameras
    """One per photo, of the photo's size."""
    photos: Sequence[UInt8[Tensor, "_ _ 3"]]
    """Undistorted photos, sRGB, over black where they are transparent."""
    label_maps: Sequence[OwnLabels | None] | None = None
    """Per photo the label id of each pixel, 0 = background; None where a photo has none."""
    points: Float[Tensor, "M 3"] | None = None
    """Sparse points in the world, to start training from."""
    point_colors: UInt8[Tensor, "M 3"] | None = None
    """Colours of `points`."""
    path: Path | None = None
    """The folder that this was read from."""
    object_names: Mapping[int, str] = field(default_factory=dict)
    """Names of objects by label id; most objects have none."""
    full: Cameras | None = None
    """The cameras at the photos' full size, if the photos are smaller here."""
    downscale: float = 1.0
    """The factor by which the photos are smaller than at full size."""
    outliers: Outliers = field(default_factory=Outliers)
    """Photos and points that were left out, as they lay far from all others."""
    alphas: Sequence[UInt8[Tensor, "_ _"] | None] | None = None
    """Opacities of the pixels of cut-out photos, 255 = opaque; None for a photo without alpha."""
    world_offset: Offset = ORIGIN
    """What was subtracted from the world's coordinates, which may be too large for float32; cameras
    and points are relative to it."""
    valid_masks: Sequence[Bool[Tensor, "_ _"] | None] | None = None
    """Per photo the pixels to train on and to measure; None where they are all."""
    held_out: frozenset[str] | None = None
    """Names of the photos that the capture's files hold out of training; None if not said."""

    def __post_init__(self) -> None:
        given = {
            "photos": self.photos,
            "label maps": self.label_maps,
            "alphas": self.alphas,
            "masks": self.valid_masks,
        }
        for what, items in given.items():
            if items is not None and len(items) != len(self.cameras):
                raise StyleSplatError(
                    f"Expected {len(self.cameras)} {what}, one per camera, got {len(items)}."
                )

    def __repr__(self) -> str:
        of = f" of {join_names(self.object_names.values())}" if self.object_names else ""
        return noun_repr(
            self,
            count_noun(len(self), "photo"),
            pixels(self.cameras.sizes),
            None if self.label_maps is None else f"label maps{of}",
            None if self.points is None else count_noun(len(self.points), "point"),
            self.path,
        )

    def __len__(self) -> int:
        return len(self.cameras)

    def only(self, rows: Sequence[int]) -> "Capture":
        """The capture with some of its photos."""

        def some(items: Sequence[Any] | None) -> Any:
            return None if items is None else Lazy([partial(items.__getitem__, r) for r in rows])

        return replace(
            self,
            cameras=self.cameras[[*rows]],
            photos=some(self.photos),
            label_maps=some(self.label_maps),
            full=None if self.full is None else self.full[[*rows]],
            outliers=Outliers(),
            alphas=some(self.alphas),
            valid_masks=some(self.valid_masks),
        )

    def without_outliers(self) -> "Capture":
        """The capture without cameras and points far from all others, which a line names."""
        near, points, found = find_outliers(self.cameras, self.points)
        if not found:
            return self
        say(f"Left out: {found}.")
        capture = self.only(near.nonzero()[:, 0].tolist())
        if points is not None and self.points is not None:
            colors = None if self.point_colors is None else self.point_colors[points]
            capture = replace(capture, points=self.points[points], point_colors=colors)
        return replace(capture, outliers=found)

    @property
    def full_cameras(self) -> Cameras:
        """The cameras at the photos' full size."""
        return self.cameras if self.full is None else self.full

    def labels(self, row: int) -> OwnLabels | None:
        """The label map of a photo, if it has one."""
        return None if self.label_maps is None else self.label_maps[row]

    def alpha(self, row: int) -> UInt8[Tensor, "_ _"] | None:
        """The opacities of a photo's pixels; None if all are opaque."""
        return None if self.alphas is None else self.alphas[row]

    def valid(self, row: int) -> Bool[Tensor, "_ _"] | None:
        """The pixels of a photo to train on and to measure; None if they are all."""
        return None if self.valid_masks is None else self.valid_masks[row]


FINGERPRINT_PHOTOS = 5  # read for a fingerprint; users exchange all photos at once, or rename them


def fingerprint(capture: Capture, *, photos: int = FINGERPRINT_PHOTOS) -> str:
    """A digest of a capture.

    All label maps and masks are read, once and one at a time, but only so many photos: about 0.6 s
    for 50 captured at 1080x1920, and 3 s for 300 at 1600x1066.
    """
    cameras = capture.cameras
    names = [*cameras.names, *sorted(capture.object_names.items())]
    names += [] if capture.held_out is None else [sorted(capture.held_out)]
    tensors = (cameras.sizes.long(), cameras.viewmats.float(), cameras.Ks.float())
    rows = evenly_spaced(range(len(capture)), photos)
    labels = (capture.labels(row) for row in range(len(capture)))
    valid = () if capture.valid_masks is None else map(capture.valid, range(len(capture)))
    parts = chain(
        (*tensors, capture.points, capture.point_colors),
        (None if one is None else one.int() for one in labels),
        (one for row in rows for one in (capture.photos[row], capture.alpha(row))),
        valid,
    )
    digest = blake2b(repr(names).encode(), digest_size=16)
    for part in parts:
        digest.update(b"none" if part is None else f"{part.dtype}{[*part.shape]}".encode())
        if part is not None:
            digest.update(part.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


KEPT = 2 * GIB  # 4,000 photos of 480 pixels

Size = Sequence[int]  # height and width


def at_most(capture: Capture, length: int) -> Capture:
    """The capture with sides of at most so many pixels; photos are made on access and cached."""
    cameras = capture.cameras.at_most(length)
    if cameras is capture.cameras:
        return capture
    cache, sizes = Cache[tuple[str, int]](KEPT), cameras.sizes.tolist()

    def smaller(name: str, shrink: Callable[[Any, Size], Tensor]) -> Lazy | None:
        items = getattr(capture, name)

        def make(row: int) -> tuple[Tensor | None]:
            item, (width, height) = items[row], sizes[row]
            return (None if item is None else shrink(item, (height, width)),)

        def get(row: int) -> Tensor | None:
            return cache.get((name, row), partial(make, row))[0]

        return None if items is None else Lazy([partial(get, row) for row in range(len(capture))])

    return replace(
        capture,
        cameras=cameras,
        photos=smaller("photos", _averaged),
        alphas=smaller("alphas", _averaged),
        label_maps=smaller("label_maps", resize_labels),
        valid_masks=smaller("valid_masks", shrink_mask),
        full=capture.full_cameras,
        downscale=capture.downscale * capture.cameras.shrink_to(length),
    )


def _averaged(pixels: UInt8[Tensor, "H W *D"], size: Size) -> UInt8[Tensor, "h w *D"]:
    return torch.from_numpy(cv2.resize(pixels.numpy(), size[::-1], interpolation=cv2.INTER_AREA))

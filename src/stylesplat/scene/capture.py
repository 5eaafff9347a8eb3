"""The `Capture` noun: posed photos, with label maps if there are any; resized, fingerprinted."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, some
from stylesplat.scene.cache import GIB, Cache, Lazy
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import OwnLabels, resize_labels
from stylesplat.scene.one_line import counted, one_line, pixels
from stylesplat.scene.sampling import evenly


@dataclass(frozen=True)
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
    alphas: Sequence[UInt8[Tensor, "_ _"] | None] | None = None
    """Opacities of the pixels of cut-out photos, 255 = opaque; None for a photo without alpha."""

    def __post_init__(self) -> None:
        given = {"photos": self.photos, "label maps": self.label_maps, "alphas": self.alphas}
        for what, items in given.items():
            if items is not None and len(items) != len(self.cameras):
                raise StyleSplatError(
                    f"Expected {len(self.cameras)} {what}, one per camera, got {len(items)}."
                )

    def __repr__(self) -> str:
        of = f" of {some(self.object_names.values())}" if self.object_names else ""
        return one_line(
            self,
            counted(len(self), "photo"),
            pixels(self.cameras.sizes),
            None if self.label_maps is None else f"label maps{of}",
            None if self.points is None else counted(len(self.points), "point"),
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
            alphas=some(self.alphas),
        )

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


PHOTOS = 5  # read for a fingerprint; users exchange all photos at once, or rename them
DIGEST = 8  # bytes of each part


def fingerprint(capture: Capture, *, photos: int = PHOTOS) -> str:
    """Digests of a capture's parts, `PART=DIGEST` separated by spaces; see `differences`.

    All label maps are read, once and one at a time, but only so many photos: about 0.6 s for 50
    captured at 1080x1920, and 3 s for 300 at 1600x1066.
    """
    rows = evenly(range(len(capture)), photos)
    cameras = capture.cameras
    labels = (capture.labels(row) for row in range(len(capture)))
    parts = {
        "names": _digest([repr(cameras.names)]),
        "size": _digest([cameras.sizes.long()]),
        "poses": _digest([cameras.viewmats.float(), cameras.Ks.float()]),
        "points": _digest([capture.points, capture.point_colors]),
        "labels": _digest(None if one is None else one.int() for one in labels),
        "objects": _digest([repr(sorted(capture.object_names.items()))]),
        "photos": _digest(one for row in rows for one in (capture.photos[row], capture.alpha(row))),
    }
    return " ".join(f"{part}={digest}" for part, digest in parts.items())


DIFFERENCES = {
    "names": "other photos",
    "size": "photos of another size",
    "poses": "other poses",
    "points": "other points",
    "labels": "other label maps",
    "objects": "other names of objects",
    "photos": "photos with other content",
}
CAUSES = ("names", "size")  # if these differ, nearly all others do


def differences(one: str, other: str) -> list[str]:
    """How the captures of two fingerprints differ, in a few words each.

    Example:
        >>> differences("size=1 poses=2 labels=3", "size=1 poses=2 labels=4")
        ['other label maps']
    """
    mine, theirs = (dict(part.split("=") for part in text.split()) for text in (one, other))
    changed = [part for part in DIFFERENCES if mine.get(part) != theirs.get(part)]
    cause = [part for part in changed if part in CAUSES]
    return [DIFFERENCES[part] for part in cause[:1] or changed]


def _digest(parts: Iterable[Tensor | str | None]) -> str:
    digest = blake2b(digest_size=DIGEST)
    for part in parts:
        if isinstance(part, Tensor):
            content = part.cpu().contiguous()
            digest.update(f"{part.dtype}{[*part.shape]}".encode())
            digest.update(content.numpy().tobytes())
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()


KEPT = 2 * GIB  # 4,000 photos of 480 pixels

Size = Sequence[int]  # height and width


def at_most(capture: Capture, length: int) -> Capture:
    """The capture with photos, label maps and cameras whose sides have at most so many pixels.

    Smaller photos are made on first access and cached.
    """
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
        full=capture.full_cameras,
        downscale=capture.downscale * capture.cameras.shrink_to(length),
    )


def _averaged(pixels: UInt8[Tensor, "H W *D"], size: Size) -> UInt8[Tensor, "h w *D"]:
    """Resize a picture by averaging."""
    import cv2  # here, as commands without photos do not need it

    return torch.from_numpy(cv2.resize(pixels.numpy(), size[::-1], interpolation=cv2.INTER_AREA))

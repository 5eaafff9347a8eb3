"""The `Capture` noun: posed photos, with label maps if there are any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, some
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import OwnLabels
from stylesplat.scene.lazy import Lazy
from stylesplat.scene.one_line import counted, one_line, pixels


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
    """What objects are called, by label id; most have no name."""
    full: Cameras | None = None
    """The cameras at the photos' full size, if the photos are smaller here."""
    downscale: float = 1.0
    """How many times smaller they are."""
    alphas: Sequence[UInt8[Tensor, "_ _"] | None] | None = None
    """Of cut-out photos how opaque each pixel is, 255 = wholly; None where a photo has no alpha."""

    def __post_init__(self) -> None:
        for what, items in (
            ("photos", self.photos),
            ("label maps", self.label_maps),
            ("alphas", self.alphas),
        ):
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
        """How opaque the pixels of a photo are; None if they all are."""
        return None if self.alphas is None else self.alphas[row]

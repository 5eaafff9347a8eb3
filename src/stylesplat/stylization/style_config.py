"""Settings of the stylisation."""

from dataclasses import dataclass, replace
from typing import Literal

from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import MAX_INTENSITY, check_intensity
from stylesplat.stylization.stages import (
    FINEST,
    SCALE,
    SMALLEST,
    Quality,
    Stage,
    planned,
    usual_growth,
    usual_steps,
)

LAYERS = range(1, 5)  # groups that the networks share
MOST_STEPS = 10**6  # a day on a CPU
MAX_SEED = 10**18  # that of torch is somewhat larger
LARGEST = 1e4  # of any setting: more is a slip, or no number

Network = Literal["compact", "vgg16", "vgg19"]
ColorMode = Literal["style", "keep", "blend", "free"]
ViewDependence = Literal["drop", "keep", "train"]
Pattern = Literal["small", "medium", "large", "photo"]
Precision = Literal["float32", "bfloat16"]

SOFTENED = 0.75  # of the object's pattern: all of it takes mouths along, half leaves a vase its own
DEFAULT_NETWORK: Network = "compact"  # it ships with the package
SIZES: dict[Pattern, int | None] = {"small": 224, "medium": 160, "large": 112, "photo": None}


@dataclass(frozen=True)
class StyleConfig:
    """How to repaint an object. The defaults are what looks best so far."""

    quality: Quality = "normal"
    """How fine the paint is: draft takes few steps and lays no canvas, normal ends at the photos'
    size, which gives strokes their edges, and high takes more steps there."""
    steps: int | None = None
    """Optimiser steps per object, one view each; by default as many as the quality needs."""
    layers: tuple[int, ...] = (3,)
    """Groups of network layers (between two poolings, 1 to 4) whose features are matched."""
    pattern: Pattern = "medium"
    """Size of strokes and shapes: features are matched on renders of the object in which its
    longer side has 224, 160 or 112 pixels at a scale of 2, fewer at first; or, photo, on renders
    as large as the photos."""
    scale: float = SCALE
    """Size of the strokes: the longer side of the style image, in longer sides of the object.

    These renders become smaller then, and larger for less; for more than 2, what is finer than
    the strokes is taken away in step.
    """
    rotate: float = 0.0
    """Degrees to turn the style image by, counter-clockwise."""
    region: tuple[int, int, int, int] | None = None
    """The part of the style image to use, x0 y0 x1 y1 in its pixels; by default all of it."""
    intensity: float = 1.0
    """How much of the style to blend in: 0 changes nothing, 1 takes all, 1.5 exaggerates."""
    color: ColorMode = "style"
    """Whose hues the object has: the style's, its own (keep), half of both (blend), or whatever
    matching features alone gives (free)."""
    form: float = 1.0
    """How much of the object's form to keep, 0 to 1.5: the luminance detail that stands out from
    what the object has everywhere, such as eyes, a mouth, folds. Its pattern is painted over."""
    content: float = 0.0
    """How much of the object's own features to keep: 0 none, 0.5 half-way, 1 nearly all.

    More counts as 1: the weights that it once was went up to 2.
    """
    view_dependence: ViewDependence = "drop"
    """What becomes of highlights and reflections: painted over, kept, or trained too, which leaves
    colours out of range where they end up there."""
    max_growth: float | None = None
    """Maximum growth: with its canvas the object may have this many times its Gaussians.

    1 lays no canvas: the object's own Gaussians are painted. None leaves it to quality and object:
    1 for draft, else 4, and up to 16 for an object of few Gaussians.
    """
    lr: float = 0.1
    """Adam's step for the constant colour band."""
    final_lr: float = 0.1
    """The last step's rate, as a share of the first's."""
    hard: bool = False
    """Paint all picked Gaussians alike; else each by how much of it belongs to the object, and
    more slowly where it hardly shows."""
    view_share: float = 1.0
    """Share of the views that see the object to optimise on, evenly chosen."""
    object_size: int | None = None
    """Longer side of the object when features are matched, in pixels, at most; None leaves it to
    pattern."""
    seed: int = 0
    """The same seed and number of threads give the same result."""

    def __post_init__(self) -> None:
        for name in ("steps", "scale", "lr", "final_lr", "object_size"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise StyleSplatError(f"Cannot stylise with {name} {value}: it must exceed 0.")
        if not self.content >= 0:
            raise StyleSplatError(f"Cannot stylise with content {self.content}: use 0 or more.")
        for name in ("scale", "lr", "content", "rotate", "max_growth", "object_size"):
            if not abs(getattr(self, name) or 0) <= LARGEST:
                raise StyleSplatError(
                    f"Cannot stylise with {name} {getattr(self, name)}: use {LARGEST:g} at most."
                )
        if self.all_steps > MOST_STEPS or abs(self.seed) > MAX_SEED:
            raise StyleSplatError(
                f"Cannot stylise with steps {self.steps} and seed {self.seed}: use {MOST_STEPS:g} "
                f"and {MAX_SEED:.0e} at most."
            )
        if not self.layers or not set(self.layers) <= set(LAYERS):
            raise StyleSplatError(
                f"Cannot match the layer groups {list(self.layers)}: name some of 1 to 4."
            )
        check_intensity(self.intensity)
        if not 0 <= self.form <= MAX_INTENSITY:
            raise StyleSplatError(
                f"Cannot stylise with form {self.form}: use 0 to {MAX_INTENSITY:g}."
            )
        if not 0 < self.view_share <= 1:
            raise StyleSplatError(
                f"Cannot use a share of {self.view_share} of the views: use more than 0, up to 1."
            )
        if self.max_growth is not None and not self.max_growth >= 1:
            raise StyleSplatError(
                f"Cannot let an object grow to {self.max_growth} times its Gaussians: use 1 (no "
                "canvas) or more."
            )

    @property
    def softened(self) -> float:
        """How much of the object's own pattern to take away before it is painted, 0 to 1."""
        return 0.0 if self.color == "free" else SOFTENED * (1 - min(self.content, 1.0))

    @property
    def levelled(self) -> float:
        """How much to take away of what is finer than strokes larger than usual, 0 to 1."""
        follows = self.object_size or SIZES[self.pattern]  # else no render shows less
        return max(0.0, 1 - SCALE / self.scale) if follows else 0.0

    def growth(self, gaussians: int) -> float:
        """How many times as many Gaussians an object of so many may get, whoever chose it."""
        return usual_growth(self.quality, gaussians) if self.max_growth is None else self.max_growth

    @property
    def all_steps(self) -> int:
        """The steps, whoever chose them."""
        return usual_steps(self.quality) if self.steps is None else self.steps

    def stages(self, photo_length: float) -> list[Stage]:
        """What is looked at in which size for how many steps, coarse first.

        Args:
            photo_length: The object's longer side in the photos, in pixels.
        """
        size = self.object_size or SIZES[self.pattern]
        if size is None:
            return [Stage((photo_length,), self.all_steps)]
        photos = float(self.object_size or photo_length)
        return planned(
            self.quality,
            pattern_length=float(size),
            photo_length=photos,
            most=float(self.object_size or max(SMALLEST * size, min(photos, FINEST))),
            steps=self.all_steps,
            scale=self.scale,
            canvas=self.growth(1) > 1,
        )

    def finest(self, photo_length: float) -> float:
        """The object's longer side in pixels for which Gaussians are split; large strokes have
        edges as sharp as others.

        Args:
            photo_length: The same in the photos.
        """
        scales = {self.scale, SCALE}
        return max(replace(self, scale=s).stages(photo_length)[-1].lengths[-1] for s in scales)


PRESETS = {
    "default": StyleConfig(),
    "paper": StyleConfig(
        steps=500,
        lr=0.0025,
        final_lr=1.0,
        color="free",
        form=0.0,
        view_dependence="train",
        max_growth=1.0,
        hard=True,
        view_share=0.25,
        pattern="photo",
    ),
}
"""`paper` keeps to StyleSplat's section 4: NNFM alone on all bands, at the rates of its code."""
NETWORKS: dict[str, Network] = {"default": DEFAULT_NETWORK, "paper": "vgg16"}
"""The network of each preset, unless another one is asked for."""

"""Settings of painting and recolouring. They load no torch: the command line starts at once."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from PIL import ImageColor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.options import MAX_INTENSITY, Config, Option, Seed, with_settings
from stylesplat.progress import say

MAX_FACTOR = 4  # with larger factors hardly anything but clipped colours is left


@dataclass(frozen=True)
class RecolorConfig(Config):
    """How to change colours, in this order. Hue to contrast are as the filters of CSS."""

    verb: ClassVar = "recolor"
    swap: tuple[str, ...] = ()
    """FROM=TO, a colour of the object and what becomes of it, #rrggbb or names: its other colours,
    shadows and highlights stay. May be repeated."""
    match: str | None = None
    """File of a picture: the object takes on the mean and covariance of its colours."""
    tint: str | None = None
    """Colour that the object takes on average; light and shade stay: #rrggbb or a name."""
    hue: Annotated[float, Option(-360, 360, label="Hue", slider=(-180, 180), step=5)] = 0.0
    """Degrees to turn the hues by; luma stays."""
    saturation: Annotated[float, Option(0, MAX_FACTOR, label="Saturation", slider=(0, 3))] = 1.0
    """Distance of the colours from grey: 0 for grey, 1 as it is, up to 4."""
    temperature: Annotated[float, Option(-1, 1, label="Warmth", slider=(-1, 1))] = 0.0
    """-1 for bluish light to 1 for yellowish light."""
    brightness: Annotated[float, Option(0, MAX_FACTOR, label="Brightness", slider=(0.2, 2))] = 1.0
    """Factor on the colours, 0 to 4."""
    contrast: Annotated[float, Option(0, MAX_FACTOR, label="Contrast", slider=(0.2, 2))] = 1.0
    """Factor on their distance from mid-grey, 0 to 4."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tint is not None:
            parse_color(self.tint)
        for text in self.swap:
            parse_swap(text)

    @property
    def changed(self) -> dict[str, Any]:
        """The settings that are not the defaults."""
        return {k: v for k, v in asdict(self).items() if v != getattr(RecolorConfig, k)}


def recolor_config(settings: Mapping[str, Any]) -> RecolorConfig:
    """The settings of a recolouring, which are not all the defaults."""
    settings = {name: str(v) if isinstance(v, Path) else v for name, v in settings.items()}
    config = with_settings(RecolorConfig(), settings)
    if not config.changed:
        raise StyleSplatError(
            "Nothing to recolor. Pass a --hue, --saturation, --brightness, --contrast, "
            "--temperature, --tint, --swap or --match."
        )
    return config


def parse_color(text: str) -> tuple[float, ...]:
    """The red, green and blue of `#rrggbb` or a name, in 0..1."""
    try:
        return tuple(level / 255 for level in ImageColor.getrgb(text)[:3])
    except ValueError:
        raise StyleSplatError(
            f"There is no color {shorten(text)!r}. Use #rrggbb or a name such as teal."
        ) from None


def parse_swap(text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The two colours of FROM=TO, in 0..1."""
    before, equals, after = text.partition("=")
    if not equals:
        raise StyleSplatError(
            f"Expected FROM=TO, two colors such as '#a02020=teal', got {shorten(text)!r}."
        )
    return parse_color(before), parse_color(after)


Network = Literal["compact", "vgg16", "vgg19"]
ColorMode = Literal["style", "keep", "blend", "free"]
Quality = Literal["draft", "normal", "high"]
Precision = Literal["float32", "bfloat16"]

DEFAULT_NETWORK: Network = "compact"  # it ships with the package
PATTERN_LENGTH = 160.0  # pixels of the object's longer side where features match best
USUAL_SCALE = 2.0  # the stroke size that the stages are made for
FINEST = 640.0  # pixels of the object's longer side: at more, windows would be too few to cover it
LEAST = 48.0  # pixels: smaller renders have too few features, however large the strokes are
SMALLEST = 2.0  # times the pattern length: for small strokes, even if the photos are smaller
WINDOW = 160  # pixels: a step in a window costs as much as a coarse step
# Discs on an object of few Gaussians, and in a multiple of its Gaussians, at most: it gets as many
# as the photos' pixels need
MANY_DISCS, MOST_DISCS = 300_000, 3.0


def parse_guide(text: str) -> tuple[float, ...]:
    """The coordinates of a line that strokes follow."""
    try:
        found = tuple(map(float, text.split(",")))
    except ValueError:
        found = ()
    if len(found) < 6 or len(found) % 3 or not all(map(math.isfinite, found)):
        raise StyleSplatError(
            f"Cannot follow the line {shorten(text)!r}. Give x,y,z,x,y,z,... of two places or more."
        )
    return found


@dataclass(frozen=True)
class Stage:
    """Steps that render the object at one size."""

    length: float
    """Its longer side in pixels; the style image follows it."""
    steps: int
    window: int | None = None
    """Side of the square windows that are rendered, in pixels; None renders the whole object."""
    rate: float = 1.0
    """Factor of the learning rate."""
    fine: bool = False
    """Whether the large shapes that were found before stay."""


@dataclass(frozen=True)
class _Row:
    """One stage of a plan."""

    steps: int
    of_pattern: float | None = None
    """The object's size, as a share of the pattern length."""
    of_photos: float | None = None
    """Or windows of it, the object's size being this share of its size in the photos."""
    rate: float = 1.0


PLANS: dict[Quality, tuple[_Row, ...]] = {
    "draft": (_Row(55, of_pattern=0.6), _Row(30, of_pattern=1.0)),
    "normal": (
        _Row(40, of_pattern=0.6),
        _Row(30, of_pattern=1.0),
        _Row(60, of_photos=0.5, rate=2.0),
        _Row(60, of_photos=1.0, rate=2.0),
    ),
    "high": (
        _Row(40, of_pattern=0.6),
        _Row(30, of_pattern=1.0),
        _Row(80, of_photos=0.5, rate=2.0),
        _Row(200, of_photos=1.0, rate=2.0),
    ),
}


@dataclass(frozen=True)
class StyleConfig(Config):
    """How to repaint an object."""

    verb: ClassVar = "stylise"
    quality: Annotated[Quality, Option(label="Quality")] = "normal"
    """draft is quick and soft and adds no Gaussians; normal paints strokes at the photos' size;
    high takes more steps there."""
    steps: Annotated[int | None, Option(1, 10**6)] = None
    """Optimiser steps per object, one view each; by default as many as the quality needs."""
    block: Annotated[int, Option(1, 4, research=True)] = 3
    """The block of the network (between two poolings, 1 to 4) whose features are matched."""
    scale: Annotated[
        float,
        Option(0.001, 10_000, name="stroke-size", label="Stroke size", slider=(0.5, 6), step=0.1),
    ] = USUAL_SCALE
    """Size of the strokes: the style picture's long side spans this many times the object's."""
    rotate: Annotated[
        float, Option(-10_000, 10_000, label="Stroke direction", slider=(0, 345), step=15)
    ] = 0.0
    """Degrees to turn the style picture by, counter-clockwise."""
    region: tuple[int, int, int, int] | None = None
    """x0, y0, x1, y1: the part of the style picture to use, in its pixels; all of it by default."""
    color: Annotated[ColorMode, Option(label="Colours")] = "style"
    """The object's hues: the style's, its own (keep), a blend, or what matching gives (free)."""
    intensity: Annotated[float, Option(0, MAX_INTENSITY)] = 1.0
    """How much of the paint to blend in: 0 changes nothing, 1 takes all, 1.5 exaggerates."""
    form: Annotated[float, Option(0, MAX_INTENSITY, label="Keep form", slider=(0, 1.5))] = 1.0
    """How much of the object's form to keep, 0 to 1.5: the detail that stands out from its
    pattern, such as eyes, a mouth, folds. Above 1 strokes give way to it."""
    content: Annotated[float, Option(0, 10_000, label="Keep pattern")] = 0.0
    """How much of the object's own features to keep, pattern included: 0 none, 1 nearly all."""
    guides: Annotated[tuple[str, ...], Option(research=True)] = ()
    """Lines on the object that the strokes near them follow, each as `x,y,z,x,y,z,...` in the
    world."""
    guide_reach: Annotated[float, Option(0.01, 1, research=True)] = 0.1
    """How far strokes follow a line, in extents of the object."""
    protect: Annotated[tuple[str, ...], Option(research=True)] = ()
    """Names of objects, such as its eyes, that get none of its paint."""
    object_size: Annotated[int | None, Option(1, 10_000, research=True)] = None
    """Longer side of the object in all renders at most, in pixels: less is quicker and softer."""
    lr: Annotated[float, Option(1e-9, 10_000, research=True)] = 0.1
    """Adam's step for the constant colour band."""
    seed: Seed = 0
    """The same seed and number of threads give the same result."""
    published: Annotated[bool, Option(research=True)] = False
    """Paint as the StyleSplat paper does: all colour bands of the object's own Gaussians, each in
    full, at the photos' size, in a quarter of the views, at a constant rate."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.published and self.quality != StyleConfig.quality:
            raise StyleSplatError(
                f"Cannot stylise with quality {self.quality} as the paper does: its method has one "
                "quality. Leave it out, or take the default preset."
            )
        if self.published and self.guides:
            raise StyleSplatError(
                "Cannot stylise with guides as the paper does: its strokes follow no lines. Leave "
                "them out, or take the default preset."
            )
        for guide in self.guides:
            parse_guide(guide)

    @property
    def all_steps(self) -> int:
        """The steps of all stages."""
        if self.steps is not None:
            return self.steps
        return sum(row.steps for row in PLANS[self.quality])

    @property
    def pattern_removed(self) -> float:
        """The share of the object's own pattern to remove before painting."""
        if self.color == "free" or self.published:
            return 0.0
        return 1 - min(self.content, 1.0)

    def max_discs(self, gaussians: int) -> int:
        """How many discs a canvas may have on an object of so many Gaussians."""
        if self.quality == "draft" or self.published:
            return 0
        return max(MANY_DISCS, int(MOST_DISCS * gaussians))

    def stages(self, photo_length: float) -> list[Stage]:
        """The sizes at which the object, so many pixels long in photos, is rendered, coarse first.

        In the coarse stages the style image has the same size in pixels whatever its scale, and
        the object becomes smaller beside it, or larger. Fine stages render windows at the photos'
        size, and the style image becomes larger, so that large strokes have sharp edges.
        """
        if self.published:
            return [Stage(min(photo_length, self.object_size or math.inf), self.all_steps)]
        pattern = float(self.object_size or PATTERN_LENGTH)
        finest = float(self.object_size or max(pattern, min(photo_length, FINEST)))
        most = float(self.object_size or max(SMALLEST * pattern, finest))
        rows = PLANS[self.quality]
        total = sum(row.steps for row in rows)
        ends = [round(self.all_steps * n / total) for n in accumulate(r.steps for r in rows)]
        stages = []
        for row, (start, end) in zip(rows, pairwise([0, *ends]), strict=True):
            if row.of_photos is not None:
                coarsest = self._scaled(pattern, most)
                length = max(coarsest, row.of_photos * finest)
                stages.append(Stage(length, end - start, WINDOW, row.rate, fine=True))
            elif row.of_pattern is not None:
                usual = row.of_pattern * pattern
                length = self._scaled(usual, most)
                window = WINDOW if length > max(usual, WINDOW) else None
                stages.append(Stage(length, end - start, window, row.rate))
        return [stage for stage in stages if stage.steps > 0]

    def _scaled(self, length: float, most: float) -> float:
        """The object's longer side beside a style of this scale, from that of the usual scale."""
        return min(max(length * USUAL_SCALE / self.scale, min(length, LEAST)), most)


STYLE_PRESETS = {
    "default": StyleConfig(),
    "paper": StyleConfig(steps=500, lr=0.0025, color="free", form=0.0, published=True),
}
"""`paper` follows section 4 of the StyleSplat paper: NNFM alone, at the rates of its code."""
NETWORKS: dict[str, Network] = {"default": DEFAULT_NETWORK, "paper": "vgg16"}
"""The network of each preset."""

RETIRED = {"canvas", "final_lr", "hard", "max_growth", "pattern", "smoothness", "texture"}
RETIRED |= {"view_dependence", "view_share", "gone", "upon"}  # of older recipes and scenes


def plain_settings(config: StyleConfig) -> dict[str, Any]:
    """Settings as JSON has them: tuples as lists."""
    return json.loads(json.dumps(asdict(config)))


def without_retired(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of an older recipe or scene, without those that there are no more."""
    retired = [key for key in settings if key in RETIRED]
    if retired:
        say(f"{', '.join(retired)}: older recipes have this; it is ignored now.")
    kept = {key: value for key, value in settings.items() if key not in retired}
    if isinstance(kept.get("layers"), list) and len(kept["layers"]) == 1:
        (kept["block"],) = kept.pop("layers")
    return kept

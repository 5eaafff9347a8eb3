"""What an object is to look like: style pictures, their sizes by strokes, and their features."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import (
    correlate1d,
    gaussian_filter,
    maximum_filter,
    minimum_filter,
    uniform_filter,
)
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice, join_names, noun_repr
from stylesplat.imaging.color import color_map, transform_rgb
from stylesplat.io.files import read_bytes
from stylesplat.io.style_pictures import Picture, is_material, picture_file, read_style, resize
from stylesplat.options import with_settings
from stylesplat.scene.layers import Blend, Source
from stylesplat.stylization.config import (
    NETWORKS,
    STYLE_PRESETS,
    USUAL_SCALE,
    ColorMode,
    Network,
    Precision,
    RecolorConfig,
    StyleConfig,
)
from stylesplat.stylization.features import FeatureNetwork

SOBEL = ((1, 2, 1), (-1, 0, 1), (1, -2, 1))  # kernels of derivatives of orders 0, 1 and 2
ORDERS = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # of derivatives along x and y
LUMA_601 = np.array([0.299, 0.587, 0.114], np.float32)  # Rec. 601
SHOCKS = 4.0  # steps of the filter that coarsens a style image, for every unit of scale
MAX_COARSENED = 8.0  # scale: beyond it strokes are as large as pictures
STYLE_RIDGE = 0.06  # curvature across a stroke, of 1: less is no stroke
# Pixels of a resized style image's longer side: of a larger one parts are used
STYLE_LARGEST = 1300.0
BROAD = 0.05  # of the object's length: what is less is a stroke
STROKE_DEVIATION = BROAD / 12**0.5  # of a blur that leaves the same as pixels so large
KEPT_HUES: dict[ColorMode, float] = {"blend": 0.5, "keep": 1.0}  # share of an object's own
STYLE_PARTS = 9  # that together are as large


@torch.no_grad()
def style_features(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, block: int, *, length: float
) -> Float[Tensor, "Q D"]:
    """The features of a block, of a style image of this longer side in pixels.

    Features that see past the border are left out, so its padding is in no style.
    """
    resized, cells = fit_style(style, network, block, length), network.cells(block)
    rows, columns = map(cells.inside, resized.shape[:2])
    return network(resized, [block])[0][rows, columns].flatten(0, 1)


def fit_style(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, block: int, length: float
) -> Float[Tensor, "_ _ 3"]:
    """The style image with this longer side, or as large as it takes to hold a whole feature."""
    cells = network.cells(block)
    least = cells.size + cells.stride - 1  # wherever its cell lies
    return resize(style, max(length, least * max(style.shape[:2]) / min(style.shape[:2])))


def all_colors(pictures: Sequence[Float[Tensor, "_ _ 3"]]) -> Float[Tensor, "P 3"]:
    """The colours of pictures, of which each has as many, whatever its size."""
    colors = [picture.reshape(-1, 3) for picture in pictures]
    most = max(map(len, colors))

    def repeated(each: Float[Tensor, "Q 3"]) -> Float[Tensor, "P 3"]:
        rows = torch.arange(most, device=each.device) * len(each) // most
        return each[rows]

    return torch.cat([each if len(each) == most else repeated(each) for each in colors])


def coarsen_style(picture: Float[Tensor, "H W 3"], scale: float) -> Float[Tensor, "H W 3"]:
    """A style image for a larger scale than usual: fine strokes are joined into crisp large ones.

    A coherence-enhancing shock filter (Weickert 2003): across the flow of the strokes, bright
    ridges and dark ones grow until they meet.
    """
    if scale <= USUAL_SCALE:
        return picture
    scale = min(scale, MAX_COARSENED)
    width, square = scale / 2, (3, 3, 1)
    size = 4 * round(width) + 3
    image = resize(picture, min(STYLE_LARGEST, float(max(picture.shape[:2])))).cpu().numpy()
    image = blurred(image, width / 2)  # else extremes would grow
    for _ in range(round(SHOCKS * (scale - USUAL_SCALE))):
        smooth = blurred(image, width / 2)
        grey = blurred(image @ LUMA_601, width)
        dx, dy, xx, xy, yy = (derivative(grey, *each) for each in ORDERS)
        a, b, c = (uniform_filter(m, size, mode="mirror") for m in (dx * dx, dx * dy, dy * dy))
        across = np.arctan2(2 * b, a - c) / 2  # the flow: of the structure tensor (Bigun 1987)
        x, y = np.cos(across), np.sin(across)
        ridge = width**2 * (x**2 * xx + 2 * x * y * xy + y**2 * yy)[..., None] / STYLE_RIDGE
        grown = np.where(ridge < 0, maximum_filter(image, square), minimum_filter(image, square))
        image = (image + np.where(abs(ridge) > 1, grown, smooth)) / 2
    return torch.from_numpy(image).to(picture)


def blurred(image: Float[np.ndarray, "H W *D"], sigma: float) -> Float[np.ndarray, "H W *D"]:
    """An image averaged by a Gaussian of so many pixels; beyond its border it is mirrored."""
    return gaussian_filter(image, sigma, mode="mirror", axes=(0, 1))


def derivative(image: Float[np.ndarray, "H W"], x: int, y: int) -> Float[np.ndarray, "H W"]:
    """The derivative of an order along each axis, by Sobel's kernels."""
    for axis, order in ((1, x), (0, y)):
        image = correlate1d(image, SOBEL[order], axis=axis, mode="mirror")
    return image


def large_shapes(pictures: Sequence[Tensor], scale: float) -> list[Tensor]:
    """Style images so small that only large shapes are left: strokes melt into their mean.

    Shapes of an object that take these colours leave the rest of a style's contrast to strokes.
    """
    return [resize(each, min(scale / BROAD, float(max(each.shape[:2])))) for each in pictures]


def style_pictures(
    images: Sequence[Tensor],
    config: StyleConfig,
    own: Float[Tensor, "P 3"] | None,
    share: float = 1.0,
) -> list[Tensor]:
    """Style images for strokes of this size, with a share of the object's own hues if known."""
    if config.color != "free":
        images = [coarsen_style(image, config.scale) for image in images]
    if own is None:
        return [*images]
    to_own = color_map(all_colors(images), own)
    return [image.lerp(transform_rgb(image, to_own).clamp(0, 1), share) for image in images]


def style_parts(
    images: Sequence[Float[Tensor, "_ _ 3"]], config: StyleConfig, length: float
) -> Iterator[tuple[Float[Tensor, "_ _ 3"], float]]:
    """Style images, or random parts of those that would be very large, beside an object so long.

    With each comes the longer side that it is to have, in pixels.
    """
    size, generator = config.scale * length, torch.Generator().manual_seed(config.seed)
    for image in images:
        if size <= STYLE_LARGEST:
            yield image, size
            continue
        longer = max(image.shape[:2])
        side = longer * STYLE_LARGEST / size / 3
        down, across = (max(1, int(each / side)) for each in image.shape[:2])
        parts = [part for rows in image.chunk(down) for part in rows.chunk(across, dim=1)]
        for i in torch.randperm(len(parts), generator=generator)[:STYLE_PARTS].tolist():
            yield parts[i], size * (max(parts[i].shape[:2]) / longer)


@dataclass(frozen=True, init=False, eq=False)
class Style:
    """One or several pictures, and how to take their style.

    Example:
        >>> Style("night.jpg", scale=2).config.scale
        2.0
        >>> Style("wave.jpg", "night.jpg", preset="paper").config.steps
        500
    """

    pictures: tuple[Picture, ...]
    """Each place of the object takes the best match of all."""
    config: StyleConfig
    preset: str
    """What the settings start from, which also tells the network."""

    def __init__(
        self,
        *pictures: Picture,
        config: StyleConfig | None = None,
        preset: str = "default",
        **settings: Any,
    ) -> None:
        """Take a style.

        Args:
            pictures: Files; names of materials, such as `material:bronze`; or colours: floats in
                0..1, or bytes.
            config: All settings; by default those of the preset.
            preset: `default`, or `paper` for the method as published, VGG16 included.
            settings: Fields of `StyleConfig` to change, such as `scale=2`.
        """
        if not pictures:
            raise StyleSplatError("A style has at least one picture. Pass a file: Style('a.jpg').")
        check_choice(preset, "preset", STYLE_PRESETS)
        object.__setattr__(self, "pictures", pictures)
        object.__setattr__(self, "preset", preset)
        object.__setattr__(self, "config", with_settings(config or STYLE_PRESETS[preset], settings))

    def __repr__(self) -> str:
        default, config = asdict(StyleConfig()), asdict(self.config)
        changed = (f"{name}={config[name]!r}" for name in config if config[name] != default[name])
        titles = (p if isinstance(p, Path | str) else "a picture" for p in self.pictures)
        return noun_repr(self, join_names(Path(title).name for title in titles), *changed)

    def read(self) -> tuple[Float[Tensor, "_ _ 3"], ...]:
        """The pictures, cropped and turned."""
        turned = {"rotate": self.config.rotate, "region": self.config.region}
        return tuple(read_style(picture, **turned) for picture in self.pictures)

    @property
    def network(self) -> Network:
        """The network whose features are matched, unless another one is asked for."""
        return NETWORKS[self.preset]

    def sources(self) -> tuple[Source, ...]:
        """Where the pictures come from, with the digests of their content."""
        return tuple(map(source_of, self.pictures))


@dataclass(frozen=True)
class StyledObject:
    """One object of a recipe, by a name that `select` gave, or a label id.

    With a slash and a label behind it (`vase/2`) it is another layer of paint on that object.
    """

    name: str
    style: Style
    features: Network | None = None
    """The network whose features are matched; None leaves it to the verb or the style's preset."""
    weights: Source | None = None
    """The network's file; None for its own."""
    intensity: float | None = None
    """How strong it is to be in the end; None for the style's."""
    form: float | None = None
    """How much form it is to show in the end; None for the style's."""
    precision: Precision | None = None
    """Of the features; None takes what is fastest on the machine."""
    blend: Blend = "normal"
    """What of the colours below it changes."""
    mask: Path | None = None
    """The file of a layer with the mask to show it through."""


@dataclass(frozen=True)
class RecoloredObject:
    """A recolouring of a recipe."""

    name: str
    config: RecolorConfig
    strength: float = 1.0
    place: int = 0
    """How many of the recipe's objects are painted before."""
    blend: Blend = "normal"
    """What of the colours below it changes."""
    mask: Path | None = None
    """The file of a layer with the mask to show it through."""


@dataclass(frozen=True)
class StoredLayer:
    """A layer of a recipe that is not painted but taken from a file."""

    name: str
    path: Path
    strength: float = 1.0
    place: int = 0
    """How many of the recipe's objects are painted before."""
    blend: Blend = "normal"


@dataclass(frozen=True)
class Recipe:
    """Which objects to repaint, and how."""

    objects: tuple[StyledObject, ...] = ()
    """The lowest layer first, each once."""
    recolors: tuple[RecoloredObject | StoredLayer, ...] = ()
    """What is recoloured, or taken from a file, the lowest first."""

    def protecting(self, names: tuple[str, ...]) -> "Recipe":
        """The recipe whose objects spare some more objects."""
        objects = []
        for each in self.objects:
            style, every = each.style, dict.fromkeys((*each.style.config.protect, *names))
            config = replace(style.config, protect=tuple(every))
            style = Style(*style.pictures, config=config, preset=style.preset)
            objects.append(replace(each, style=style))
        return replace(self, objects=tuple(objects))


def as_style(style: Style | Picture | Sequence[Picture]) -> Style:
    """A style, or that of one or several pictures with the default settings."""
    pictures = (style,) if isinstance(style, Path | str | Tensor) else style
    return pictures if isinstance(pictures, Style) else Style(*pictures)


def as_recipe(styles: Mapping[str, Style | Picture | Sequence[Picture]] | Recipe) -> Recipe:
    """Objects and their styles or pictures as a recipe with the default settings."""
    if isinstance(styles, Recipe):
        return styles
    named = (StyledObject(str(name), as_style(style)) for name, style in styles.items())
    return Recipe(tuple(named))


def digest(path: Path) -> str:
    """The SHA-256 of a file, or of a material's picture."""
    return sha256(read_bytes(picture_file(path))).hexdigest()


def source_of(picture: Picture) -> Source:
    """Where a picture comes from. The path of a material is its name."""
    if isinstance(picture, Tensor):
        colors = picture.detach().to("cpu", torch.float32).contiguous()
        return Source(None, sha256(colors.numpy().tobytes()).hexdigest())
    path = Path(picture) if is_material(picture) else Path(picture).resolve()
    return Source(path, digest(path))

"""What an object is to look like: pictures, and how to take their style."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.color.recolor_config import RecolorConfig
from stylesplat.errors import StyleSplatError, check_choice, some
from stylesplat.io.files import read_bytes
from stylesplat.io.style_pictures import Picture, is_material, picture_file, read_style
from stylesplat.scene.layer import Source
from stylesplat.scene.one_line import one_line
from stylesplat.stylization.config import (
    NETWORKS,
    PRESETS,
    Network,
    Precision,
    StyleConfig,
    with_settings,
)


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
        check_choice(preset, "preset", PRESETS)
        object.__setattr__(self, "pictures", pictures)
        object.__setattr__(self, "preset", preset)
        object.__setattr__(self, "config", with_settings(config or PRESETS[preset], settings))

    def __repr__(self) -> str:
        default, config = asdict(StyleConfig()), asdict(self.config)
        changed = (f"{name}={config[name]!r}" for name in config if config[name] != default[name])
        titles = (p if isinstance(p, Path | str) else "a picture" for p in self.pictures)
        return one_line(self, some(Path(title).name for title in titles), *changed)

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
    """One object of a recipe, by a name that `select` gave, or a label id."""

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


@dataclass(frozen=True)
class RecoloredObject:
    """A recolouring of a recipe."""

    name: str
    config: RecolorConfig
    strength: float = 1.0
    place: int = 0
    """How many of the recipe's objects are painted before."""


@dataclass(frozen=True)
class Recipe:
    """Which objects to repaint, and how."""

    objects: tuple[StyledObject, ...] = ()
    """The lowest layer first, each once."""
    recolors: tuple[RecoloredObject, ...] = ()
    """The lowest first."""

    def protecting(self, names: tuple[str, ...]) -> "Recipe":
        """The recipe whose objects spare some more objects."""
        objects = []
        for each in self.objects:
            style, every = each.style, dict.fromkeys((*each.style.config.protect, *names))
            config = replace(style.config, protect=tuple(every))
            style = Style(*style.pictures, config=config, preset=style.preset)
            objects.append(replace(each, style=style))
        return replace(self, objects=tuple(objects))


def as_recipe(styles: Mapping[str, Style | Picture | Sequence[Picture]] | Recipe) -> Recipe:
    """Objects and their styles or pictures as a recipe with the default settings."""
    if isinstance(styles, Recipe):
        return styles
    objects = []
    for name, style in styles.items():
        pictures = (style,) if isinstance(style, Path | str | Tensor) else style
        style = pictures if isinstance(pictures, Style) else Style(*pictures)
        objects.append(StyledObject(str(name), style))
    return Recipe(tuple(objects))


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

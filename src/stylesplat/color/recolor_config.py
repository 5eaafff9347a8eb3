"""Settings of a recolouring; they load no torch, so that the command line starts at once."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_type_hints

from PIL import ImageColor

from stylesplat.argument_kinds import check_settings, convert_settings
from stylesplat.errors import StyleSplatError, brief

RECOLOR_LIMITS = {  # of settings; with larger factors hardly anything but clipped colours is left
    "hue": (-360, 360),
    "saturation": (0, 4),
    "temperature": (-1, 1),
    "brightness": (0, 4),
    "contrast": (0, 4),
}


@dataclass(frozen=True)
class RecolorConfig:
    """How to change colours, in this order. Hue to contrast are as the filters of CSS."""

    match: str | None = None
    """File of a picture whose colours the object is to have, in mean and covariance."""
    tint: str | None = None
    """Colour that the object is to have, but for its light and shade: #rrggbb or a name."""
    hue: float = 0.0
    """Degrees to turn the hues by; luma stays."""
    saturation: float = 1.0
    """Distance of the colours from grey: 0 for grey, 1 as it is, up to 4."""
    temperature: float = 0.0
    """-1 for bluish light to 1 for yellowish light."""
    brightness: float = 1.0
    """Factor on the colours, 0 to 4."""
    contrast: float = 1.0
    """Factor on their distance from mid-grey, 0 to 4."""

    def __post_init__(self) -> None:
        check_settings(self, "recolor", RECOLOR_LIMITS)
        if self.tint is not None:
            parse_color(self.tint)

    @property
    def changed(self) -> dict[str, Any]:
        """The settings that are not the defaults."""
        return {k: v for k, v in asdict(self).items() if v != getattr(RecolorConfig, k)}


def recolor_config(settings: Mapping[str, Any]) -> RecolorConfig:
    """The settings of a recolouring, which are not all the defaults."""
    settings = {name: str(v) if isinstance(v, Path) else v for name, v in settings.items()}
    config = RecolorConfig(**convert_settings(settings, get_type_hints(RecolorConfig)))
    if not config.changed:
        raise StyleSplatError(
            "Nothing to recolor. Pass a --hue, --saturation, --brightness, --contrast, "
            "--temperature, --tint or --match."
        )
    return config


def parse_color(text: str) -> tuple[float, ...]:
    """The red, green and blue of `#rrggbb` or a name, in 0..1."""
    try:
        return tuple(level / 255 for level in ImageColor.getrgb(text)[:3])
    except ValueError:
        raise StyleSplatError(
            f"There is no color {brief(text)!r}. Use #rrggbb or a name such as teal."
        ) from None

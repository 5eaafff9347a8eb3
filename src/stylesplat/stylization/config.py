"""Settings of the stylisation."""

from dataclasses import dataclass

from stylesplat.errors import StyleSplatError

MAX_INTENSITY = 1.5  # beyond it colours leave their range


@dataclass(frozen=True)
class StyleConfig:
    """How to repaint an object. The defaults are what looks best so far."""

    steps: int = 200
    """Optimiser steps per object, one view each."""
    blocks: tuple[int, ...] = (3,)
    """Blocks of VGG whose features are matched; deeper ones carry larger strokes."""
    scale: float = 2.0
    """Longer side of the style image, in longer sides of the object; 2 doubles the strokes."""
    intensity: float = 1.0
    """How much of the new colours to blend into the old: 0 changes nothing, 1 takes all.

    More, up to 1.5, exaggerates.
    """
    lr: float = 0.1
    """Adam's step for the constant colour band."""
    final_lr: float = 0.1
    """The last step's rate, as a share of the first's."""
    view_dependent: bool = False
    """Whether the other bands are optimised too, at a twentieth of the rate."""
    color_transfer: bool = True
    """Whether the object first takes on the mean and covariance of the style's colours."""
    view_share: float = 1.0
    """Share of the views that see the object to optimise on, evenly chosen."""
    object_size: int | None = 192
    """Longer side of the object in the renders, in pixels; None leaves it as in the photos."""
    style_samples: int | None = 4096
    """How many features of the style image to keep, at random; None keeps all."""
    seed: int = 0
    """The same seed gives the same result."""

    def __post_init__(self) -> None:
        positive = ("steps", "scale", "lr", "final_lr", "object_size", "style_samples")
        for name in positive:
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise StyleSplatError(f"Cannot stylise with {name} {value}: it must exceed 0.")
        if not self.blocks:
            raise StyleSplatError("Cannot stylise without features: name at least one block.")
        check_intensity(self.intensity)
        if not 0 < self.view_share <= 1:
            raise StyleSplatError(
                f"Cannot use a share of {self.view_share} of the views: use more than 0, up to 1."
            )


def check_intensity(intensity: float) -> None:
    """Raise a StyleSplatError if colours cannot be blended so."""
    if not 0 <= intensity <= MAX_INTENSITY:
        raise StyleSplatError(f"Cannot blend with intensity {intensity}: use 0 to {MAX_INTENSITY}.")


PRESETS = {
    "default": StyleConfig(),
    "paper": StyleConfig(
        steps=500,
        lr=0.0025,
        final_lr=1.0,
        view_dependent=True,
        color_transfer=False,
        view_share=0.25,
        object_size=None,
        style_samples=None,
    ),
}
"""`paper` keeps to StyleSplat's section 4: NNFM alone on all bands, at the rates of its code."""

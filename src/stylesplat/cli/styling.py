"""The verbs that repaint objects: what they take, and which function does the work.

Libraries are imported when a verb runs, so that `--help` answers at once.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.options import Device, Json, OptionalOutput, Output, Overwrite, given
from stylesplat.cli.parse import parse_style
from stylesplat.stylization.style_config import DEFAULT_NETWORK, Network


@dataclass(frozen=True)
class Stylize:
    """Repaint objects of a scene, each in the style of a picture.

    Example: stylesplat stylize garden-scene --style vase=wave.jpg -o garden-wave
    """

    scene: Positional[Path]
    """Folder of the scene."""
    output: Output
    """Folder of the styled scene to make."""
    style: UseAppendAction[tuple[str, ...]] = ()
    """OBJECT=IMAGE or OBJECT=IMAGE,IMAGE; OBJECT is a name that `select` gave, or a label id. May
    be repeated."""
    recipe: Path | None = None
    """YAML file with objects, styles and settings instead of --style; options given
    here precede its own. A styled scene's recipe.json is one too."""
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper is the method as published (which used --features vgg16)."""
    steps: int | None = None
    """Optimiser steps per object, 300 by default."""
    features: Network | None = None
    """Network whose features are matched, by default compact, which ships with the package."""
    weights: Path | None = None
    """File of the network's weights (.safetensors, .pth); VGG's are else downloaded, once."""
    pattern: Literal["small", "medium", "large", "photo"] | None = None
    """Size of strokes and shapes, medium by default; photo matches at the photos' size."""
    layers: tuple[int, ...] | None = None
    """Groups of network layers that are matched, of 1 to 4; 3 by default."""
    scale: float | None = None
    """Size of the style picture relative to the object, 2 by default: more makes larger strokes."""
    rotate: float | None = None
    """Degrees to turn the style picture by, counter-clockwise."""
    region: tuple[int, int, int, int] | None = None
    """x0 y0 x1 y1: the part of the style picture to use, in its pixels."""
    intensity: float | None = None
    """How much of the new colours to blend into the old, 0 to 1.5; see also `adjust`."""
    color: Literal["style", "keep", "blend", "free"] | None = None
    """Whose hues the object gets: the style's (default), its own, both, or what matching gives."""
    content: float | None = None
    """Weight of keeping what it looks like; 0 by default, 0.5 shows more of it, 2 mostly it."""
    smoothness: float | None = None
    """Weight of the total variation; 0 by default, 1 calms, 5 makes flat areas."""
    view_dependence: Literal["keep", "drop", "train"] | None = None
    """Whether highlights and reflections stay, are painted over (default), or are trained too."""
    max_growth: float | None = None
    """Split Gaussians too large for strokes, up to 4 times as many by default; 1 splits none."""
    max_memory: float = 1.5
    """GiB for prepared views; what does not fit takes longer."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.recipe import named_styles
        from stylesplat.verbs.stylize import stylize_scene

        names = (
            *("steps", "pattern", "layers", "scale", "rotate", "region", "intensity", "color"),
            *("content", "smoothness", "view_dependence", "max_growth", "seed"),
        )
        recipe = named_styles(
            [parse_style(text) for text in self.style],
            self.recipe,
            preset=self.preset,
            settings=given(self, names),
        )
        planned = recipe.features or DEFAULT_NETWORK
        features = self.features or planned
        return stylize_scene(
            self.scene,
            self.output,
            recipe.objects,
            features=features,
            weights=self.weights or (recipe.weights if features == planned else None),
            max_memory=self.max_memory,
            device=self.device,
            overwrite=self.overwrite,
        )


@dataclass(frozen=True)
class Adjust:
    """Change how strong a style is, at once and without optimising, or undo it all.

    Example: stylesplat adjust garden-wave --intensity 0.6
    """

    scene: Positional[Path]
    """Folder of the styled scene."""
    intensity: float | None = None
    """0 for the colours before, 1 for the style's, up to 1.5 to exaggerate."""
    undo: FlagCreatePairsOff[bool] = False
    """Write the scene as it was before it was styled, to the bit, to the --output folder."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Adjust this object only. May be repeated."""
    output: OptionalOutput = None
    """Folder of a scene to make; without it the scene itself is changed."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.adjust import adjust_scene, undo_scene

        if self.undo:
            return undo_scene(self.scene, self.output, overwrite=self.overwrite)
        return adjust_scene(
            self.scene,
            self.intensity,
            names=self.object,
            output=self.output,
            overwrite=self.overwrite,
        )


@dataclass(frozen=True)
class Sheet:
    """Draw an object in a grid of styles and settings, to choose from.

    Example: stylesplat sheet garden-scene -o sheet.png --style vase=wave.jpg --vary scale=1,2,4
    """

    scene: Positional[Path]
    """Folder of the scene, which stays as it is."""
    output: Output
    """Picture to make."""
    style: UseAppendAction[tuple[str, ...]] = ()
    """OBJECT=IMAGE or OBJECT=IMAGE,IMAGE. May be repeated with other pictures for the same
    object, which are the rows then."""
    vary: UseAppendAction[tuple[str, ...]] = ()
    """KEY=VALUE,VALUE: what the columns are, and the rows if it is given twice. KEY is preset or
    a setting as in recipes; lists take brackets: layers=[3],[2,3]."""
    view: str | None = None
    """Name of the photo to look from; by default the one that shows most of the object."""
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper is the method as published (which used --features vgg16)."""
    steps: int | None = None
    """Optimiser steps per cell."""
    features: Network = DEFAULT_NETWORK
    """Network whose features are matched; compact ships with the package."""
    weights: Path | None = None
    """File of the network's weights (.safetensors, .pth); VGG's are else downloaded, once."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.settings import parse_variation
        from stylesplat.verbs.sheet import draw_sheet, plan_sheet

        plan = plan_sheet(
            [parse_style(text) for text in self.style],
            [parse_variation(text) for text in self.vary],
            settings={"preset": self.preset, **given(self, ("steps", "seed"))},
        )
        return draw_sheet(
            self.scene,
            self.output,
            plan,
            view=self.view,
            features=self.features,
            weights=self.weights,
            device=self.device,
            overwrite=self.overwrite,
        )

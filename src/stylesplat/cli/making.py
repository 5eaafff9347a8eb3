"""The verbs that make scenes: what they take, and which function does the work.

Libraries are imported when a verb runs, so that `--help` answers at once.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.options import Device, Json, OptionalOutput, Output, Overwrite, given
from stylesplat.cli.parse import parse_box, parse_point, parse_style


@dataclass(frozen=True)
class Demo:
    """Make a still life, train it, repaint two of its objects and write a report.

    Example: stylesplat demo -o demo
    """

    output: Output = Path("stylesplat-demo")
    """Folder for everything that is made."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.demo.run import run_demo

        return run_demo(self.output, overwrite=self.overwrite)


@dataclass(frozen=True)
class Train:
    """Train a splat with objects from posed photos.

    Example: stylesplat train garden -o garden-scene --downscale 2 --max-seconds 120
    """

    capture: Positional[Path]
    """Folder with photos and COLMAP or transforms.json poses, and label maps in object_mask/."""
    output: Output
    """Folder of the scene to make. A run that was interrupted continues from there."""
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper takes 30,000 steps."""
    steps: int | None = None
    """Optimiser steps, one photo each."""
    max_seconds: float | None = None
    """Train for this long instead of for a number of steps."""
    max_gaussians: int | None = None
    """The number of Gaussians grows up to here."""
    downscale: float = 1.0
    """How many times smaller the photos are made."""
    test_every: int | None = None
    """Every this many photos one is held out to measure quality; 0 trains on all."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.training.config import PRESETS
        from stylesplat.verbs.train import train_scene

        names = ("steps", "max_seconds", "max_gaussians", "test_every", "seed")
        return train_scene(
            self.capture,
            self.output,
            config=replace(PRESETS[self.preset], **given(self, names)),
            downscale=self.downscale,
            masks=self.masks,
            device=self.device,
            overwrite=self.overwrite,
        )


@dataclass(frozen=True)
class Select:
    """Name an object of a scene, by label id, by a box or by a point in a photo.

    Example: stylesplat select garden-scene --name vase --point IMG_0007.jpg:640,420
    """

    scene: Positional[Path]
    """Folder of the scene."""
    name: str
    """What to call the object."""
    id: tuple[int, ...] = ()
    """Label ids, as `objects` lists them."""
    box: str | None = None
    """VIEW:x0,y0,x1,y1 in the photo's pixels: the object that shows most inside."""
    point: str | None = None
    """VIEW:x,y in the photo's pixels: the object that shows there."""
    threshold: float = 0.5
    """Probability of the object above which a Gaussian belongs to it."""
    keep_outliers: FlagCreatePairsOff[bool] = False
    """Keep Gaussians that lie apart from the rest of the object."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.objects import select_object

        return select_object(
            self.scene,
            self.name,
            ids=self.id,
            box=parse_box(self.box) if self.box else None,
            point=parse_point(self.point) if self.point else None,
            threshold=self.threshold,
            remove_outliers=not self.keep_outliers,
        )


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
    """YAML file with objects, styles and settings instead of --style; options on the command line
    are what it starts from. A styled scene's recipe.json is one too."""
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper is the method as published."""
    steps: int | None = None
    """Optimiser steps per object."""
    features: Literal["vgg16", "vgg19", "random"] | None = None
    """Network whose features are matched, vgg16 by default; random needs no file, gives less."""
    weights: Path | None = None
    """File of the network's weights (.safetensors, .pth); downloaded once if not given."""
    pattern: Literal["small", "medium", "large", "photo"] | None = None
    """Size of strokes and shapes; photo matches features at the photos' size."""
    layers: tuple[int, ...] | None = None
    """Groups of network layers that are matched, 1 to 4: deeper ones make larger patterns."""
    scale: float | None = None
    """Size of the style picture relative to the object: larger makes larger strokes."""
    rotate: float | None = None
    """Degrees to turn the style picture by, counter-clockwise."""
    region: tuple[int, int, int, int] | None = None
    """x0 y0 x1 y1: the part of the style picture to use, in its pixels."""
    intensity: float | None = None
    """How much of the new colours to blend into the old, 0 to 1.5; see also `adjust`."""
    color: Literal["style", "keep", "blend", "free"] | None = None
    """Whose hues the object gets: the style's, its own, half of both, or what matching gives."""
    content: float | None = None
    """Weight of keeping what the object looks like; 0 by default, 1 is much."""
    smoothness: float | None = None
    """Weight of flat areas (total variation); 0 by default, 1 is much."""
    view_dependence: Literal["keep", "drop", "train"] | None = None
    """Whether highlights and reflections stay, are painted over, or are trained as well."""
    max_growth: float | None = None
    """Split Gaussians too large for strokes, up to this many times as many; 1 splits none."""
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
        from stylesplat.stylization.config import PRESETS
        from stylesplat.verbs.recipe import named_styles
        from stylesplat.verbs.stylize import stylize_scene

        names = (
            *("steps", "pattern", "layers", "scale", "rotate", "region", "intensity", "color"),
            *("content", "smoothness", "view_dependence", "max_growth", "seed"),
        )
        recipe = named_styles(
            [parse_style(text) for text in self.style],
            self.recipe,
            defaults=replace(PRESETS[self.preset], **given(self, names)),
        )
        return stylize_scene(
            self.scene,
            self.output,
            recipe.objects,
            features=self.features or recipe.features or "vgg16",
            weights=self.weights or recipe.weights,
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

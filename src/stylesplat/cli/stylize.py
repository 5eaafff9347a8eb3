"""`stylesplat stylize`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction, arg

from stylesplat.cli.next_steps import next_lines, painted_commands
from stylesplat.cli.options import Device, Json, Output, Overwrite, Verbose, given
from stylesplat.cli.parse import parse_style
from stylesplat.cli.results import save_or_rescue
from stylesplat.cli.scene_pictures import before_after_line, write_before_after
from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import Network

if TYPE_CHECKING:
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene
    from stylesplat.stylization.style import Recipe, StyledObject

SETTINGS = (
    "quality",
    "steps",
    "scale",
    "rotate",
    "region",
    "intensity",
    "color",
    "form",
    "content",
    "seed",
)


@dataclass(frozen=True)
class Stylize:
    """Repaint objects of a scene, each in the style of a picture.

    Example: stylesplat stylize garden-scene --style vase=wave.jpg -o garden-wave
    """

    first: ClassVar = ("style", "recipe", "scale", "intensity", "color")
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
    """Settings to start from; paper is the method as published, with --features vgg16."""
    quality: Literal["draft", "normal", "high"] | None = None
    """How fine, normal by default: draft is quick and soft, high takes a few minutes."""
    steps: int | None = None
    """Optimiser steps per object; by default as many as the quality needs."""
    features: Network | None = None
    """Network whose features are matched, by default compact, which ships with the package; vgg16
    for --preset paper."""
    weights: Path | None = None
    """File of the network's weights (.safetensors, .pth); VGG's are else downloaded, once."""
    scale: Annotated[float | None, arg(name="stroke-size", aliases=["--scale"])] = None
    """Size of the strokes, 2 by default: as many longer sides of the object as the style picture's
    longer side has."""
    rotate: float | None = None
    """Degrees to turn the style picture by, counter-clockwise."""
    region: tuple[int, int, int, int] | None = None
    """x0 y0 x1 y1: the part of the style picture to use, in its pixels."""
    intensity: float | None = None
    """How much of the new colours to blend into the old, 0 to 1.5; see also `adjust`."""
    color: Literal["style", "keep", "blend", "free"] | None = None
    """Whose hues the object gets: the style's (default), its own, both, or what matching gives."""
    form: float | None = None
    """How much of its form the object keeps, 0 to 1.5, 1 by default: eyes, folds, edges."""
    content: float | None = None
    """How much of its own features the object keeps, 0 (default) to 1 (nearly all)."""
    max_memory: float = 1.5
    """GiB for prepared views; what does not fit takes longer."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.recovery import changing

        recipe = self._recipe()
        with changing(self.output):
            return self._stylize(recipe)

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        from stylesplat.evaluation.in_words import style_lines

        yield f"{self.output}: painted."
        yield from before_after_line(result)
        yield from next_lines(*painted_commands(self.output))
        yield from style_lines(result, result["seconds_by_object"])

    def _stylize(self, recipe: "Recipe") -> dict[str, Any]:
        from stylesplat.io.folders import refuse_occupied
        from stylesplat.io.scene_folder import SCENE, open, revise
        from stylesplat.progress import say
        from stylesplat.runtime import tidy_heap
        from stylesplat.verbs.stylize import stylize_unmeasured

        refuse_occupied(self.output, marker=SCENE, overwrite=self.overwrite)
        painted = stylize_unmeasured(
            open(self.scene),
            recipe,
            features=self.features,
            weights=self.weights,
            max_memory=self.max_memory,
            device=self.device,
        )
        save_or_rescue(painted.scene, self.output, overwrite=self.overwrite)
        say(f"The painted scene is in {self.output}. What is left is to measure and to draw it.")
        tidy_heap()
        picture = write_before_after(painted.scene, self.output, device=self.device)
        tidy_heap()
        styled = painted.measured(_capture(painted.scene))
        revise(painted.scene, styled, self.output)
        numbers = {name: value for name, value in styled.metrics.items() if name != "train"}
        return {"scene": self.output, **picture, **numbers}

    def _recipe(self) -> "Recipe":
        """The recipe of a file, or of objects and pictures that all have the same settings."""
        from stylesplat.stylization.recipe import read_recipe
        from stylesplat.stylization.style import Recipe, Style, StyledObject

        settings = given(self, SETTINGS)
        if self.recipe is None:
            styles = [parse_style(text) for text in self.style]
            if not styles:
                raise StyleSplatError(
                    "Nothing to stylise. Pass --style OBJECT=IMAGE at least once, or --recipe FILE."
                )
            return Recipe(
                tuple(
                    StyledObject(name, Style(*pictures, preset=self.preset, **settings))
                    for name, pictures in styles
                )
            )
        if self.style:
            name = parse_style(self.style[0])[0]
            raise StyleSplatError(
                f"Got --style and --recipe. Write {name} into {self.recipe}, or pass only --style."
            )
        recipe = read_recipe(self.recipe, preset=self.preset)
        return Recipe(tuple(_overridden(each, settings) for each in recipe.objects))


def _capture(scene: "Scene") -> "Capture | None":
    """The photos of a scene, if they are there; their label maps say where its objects are."""
    from stylesplat.io.captures.capture_folder import exact_masks
    from stylesplat.progress import say
    from stylesplat.verbs.load import load

    if scene.capture is None or not scene.capture.is_dir():
        return None
    try:
        masks = exact_masks(scene.capture)
        return load(scene.capture, downscale=scene.downscale, masks=masks)
    except StyleSplatError as error:  # the painting is done all the same
        say(f"Stains beside the objects are not looked for: {error}")
        return None


def _overridden(each: "StyledObject", settings: dict[str, Any]) -> "StyledObject":
    """An object of a recipe with the settings that precede its own."""
    from stylesplat.stylization.style import Style

    known = each.style
    style = Style(*known.pictures, config=known.config, preset=known.preset, **settings)
    intensity = settings.get("intensity", each.intensity)
    return replace(each, style=style, intensity=intensity)

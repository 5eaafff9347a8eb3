"""`stylesplat stylize`."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction

import stylesplat as ss
from stylesplat.cli.arguments import from_config, parse_style
from stylesplat.cli.options import Device, Features, MakingCommand, Output, Weights
from stylesplat.cli.results import (
    before_after_line,
    draw_before_after,
    next_lines,
    pasted,
    save_or_rescue,
    unused,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import changing, refuse_occupied
from stylesplat.progress import say
from stylesplat.runtime import tidy_heap
from stylesplat.stylization.config import StyleConfig

if TYPE_CHECKING:
    from stylesplat.stylization.style import Recipe

SETTINGS = from_config(
    StyleConfig,
    "quality",
    "steps",
    "scale",
    "rotate",
    "region",
    "color",
    "intensity",
    "form",
    "content",
    "seed",
    scale=("stroke-size", "scale"),
)


@dataclass(frozen=True)
class Stylize(MakingCommand):
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
    """YAML file with objects, styles and settings instead of --style; options given here precede
    its own. A styled scene's recipe.json is one too."""
    settings: Annotated[dict[str, Any], SETTINGS] = field(default_factory=dict)
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper is the method as published, with --features vgg16."""
    features: Features = None
    weights: Weights = None
    device: Device = "auto"

    def run(self) -> dict[str, Any]:
        from stylesplat.io.kinds import SCENE
        from stylesplat.io.scene_folder import revise

        recipe = self._recipe()
        picture = dict[str, Any]()

        def save(scene: "ss.Scene") -> None:
            save_or_rescue(scene, self.output, overwrite=self.overwrite)
            say(f"The painted scene is in {self.output}. Measuring and drawing are left to do.")
            tidy_heap()
            picture.update(draw_before_after(scene, self.output, device=self.device))
            tidy_heap()

        with changing(self.output):
            refuse_occupied(self.output, marker=SCENE, overwrite=self.overwrite)
            styled = ss.stylize(
                ss.open(self.scene),
                recipe,
                features=self.features,
                weights=self.weights,
                device=self.device,
                on_painted=save,
            )
            revise(replace(styled, metrics={}), styled, self.output)
        numbers = {name: value for name, value in styled.metrics.items() if name != "train"}
        return {"scene": self.output, **picture, **numbers}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        from stylesplat.evaluation.summary import style_lines

        yield f"{self.output}: painted."
        yield from before_after_line(result)
        softer = unused(self.output, "-softer")
        yield from next_lines(
            pasted("adjust", self.output, "--intensity", 0.7, "-o", softer),
            pasted("export", self.output, unused(self.output, ".ply")),
        )
        yield from style_lines(result, result["seconds_by_object"])

    def _recipe(self) -> "Recipe":
        """The recipe in the file, or that of the styles, which all have the same settings."""
        from stylesplat.stylization.style import Recipe, StyledObject

        if self.recipe is None:
            styles = [parse_style(text) for text in self.style]
            if not styles:
                raise StyleSplatError(
                    "Nothing to stylise. Pass --style OBJECT=IMAGE at least once, or --recipe FILE."
                )
            settings = {"preset": self.preset, **self.settings}
            named = [(name, ss.Style(*pictures, **settings)) for name, pictures in styles]
            return Recipe(tuple(StyledObject(name, style) for name, style in named))
        if self.style:
            name = parse_style(self.style[0])[0]
            raise StyleSplatError(
                f"Got --style and --recipe. Write {name} into {self.recipe}, or pass only --style."
            )
        objects = []
        for each in ss.read_recipe(self.recipe, preset=self.preset).objects:
            before = {"config": each.style.config, "preset": each.style.preset}
            style = ss.Style(*each.style.pictures, **before, **self.settings)
            intensity = self.settings.get("intensity", each.intensity)
            objects.append(replace(each, style=style, intensity=intensity))
        return Recipe(tuple(objects))

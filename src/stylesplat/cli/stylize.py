"""`stylesplat stylize`; `recolor`, without a style; and `adjust`, how strong the paint is."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import UseAppendAction

import stylesplat as ss
from stylesplat.cli.arguments import from_config, parse_style
from stylesplat.cli.options import (
    Device,
    EditingCommand,
    Features,
    MakingCommand,
    Output,
    SceneFolder,
    Weights,
)
from stylesplat.cli.results import (
    BEFORE_AFTER,
    before_after_line,
    draw_before_after,
    new_scene,
    next_lines,
    pasted,
    unused,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import changing
from stylesplat.progress import say
from stylesplat.runtime import tidy_heap
from stylesplat.stylization.config import RecolorConfig, StyleConfig

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
RECOLOR_SETTINGS = from_config(RecolorConfig, *vars(RecolorConfig()))


@dataclass(frozen=True)
class Stylize(MakingCommand):
    """Repaint objects of a scene, each in the style of a picture.

    Example: stylesplat stylize garden-scene --style vase=wave.jpg -o garden-wave
    """

    scene: SceneFolder
    output: Output
    """Folder of the styled scene to make."""
    style: UseAppendAction[tuple[str, ...]] = ()
    """OBJECT=IMAGE or OBJECT=IMAGE,IMAGE; OBJECT is a name that `select` gave, or a label id, IMAGE
    a file or a material (material:bronze, marble, gold-leaf, clay or jade). May be repeated."""
    recipe: Path | None = None
    """YAML file with objects, styles and settings instead of --style; options given here precede
    its own. A styled scene's recipe.json is one too."""
    protect: UseAppendAction[tuple[str, ...]] = ()
    """Name of an object that gets no paint, such as the eyes of a face (`select --of` makes such
    parts). May be repeated."""
    settings: Annotated[dict[str, Any], SETTINGS] = field(default_factory=dict)
    preset: Literal["default", "paper"] = "default"
    """Settings to start from; paper is the method as published, with --features vgg16."""
    features: Features = None
    weights: Weights = None
    device: Device = "auto"

    def run(self) -> dict[str, Any]:
        from stylesplat.io.scene_folder import revise

        recipe = self._recipe()
        picture = dict[str, Any]()
        with new_scene(self.output, overwrite=self.overwrite) as save:

            def on_painted(scene: "ss.Scene") -> None:
                save(scene)
                say(f"The painted scene is in {self.output}. Measuring and drawing are left to do.")
                tidy_heap()
                picture.update(draw_before_after(scene, self.output, device=self.device))
                tidy_heap()

            styled = ss.stylize(
                ss.open(self.scene),
                recipe,
                features=self.features,
                weights=self.weights,
                protect=self.protect,
                device=self.device,
                on_painted=on_painted,
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
            return Recipe(
                tuple(StyledObject(name, ss.Style(*files, **settings)) for name, files in styles)
            )
        if self.style:
            name = parse_style(self.style[0])[0]
            raise StyleSplatError(
                f"Got --style and --recipe. Write {name} into {self.recipe}, or pass only --style."
            )
        recipe, objects = ss.read_recipe(self.recipe, preset=self.preset), []
        for each in recipe.objects:
            before = {"config": each.style.config, "preset": each.style.preset}
            style = ss.Style(*each.style.pictures, **before, **self.settings)
            intensity = self.settings.get("intensity", each.intensity)
            objects.append(replace(each, style=style, intensity=intensity))
        return replace(recipe, objects=tuple(objects))


@dataclass(frozen=True)
class Recolor(EditingCommand):
    """Change the colours of an object or of the background, at once and without a style.

    Example: stylesplat recolor garden-scene --object vase --hue 120
    """

    object: UseAppendAction[tuple[str, ...]] = ()
    """A name or a label id; background is what belongs to no object. May be repeated."""
    settings: Annotated[dict[str, Any], RECOLOR_SETTINGS] = field(default_factory=dict)
    strength: float = 1.0
    """How much of the change to blend in, 0 to 1.5."""

    def run(self) -> dict[str, Any]:
        def change(scene: "ss.Scene") -> "ss.Scene":
            return ss.recolor(scene, self.object, strength=self.strength, **self.settings)

        with changing(self.folder):
            picture = draw_before_after(self.rewrite(change), self.folder)
        return {"scene": self.folder, "recolored": list(self.object), **picture}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        yield f"{self.folder}: {', '.join(self.object)} recoloured."
        yield from before_after_line(result)
        place, name = unused(self.folder, "-before"), f"{self.object[0]}/recolor"
        yield from next_lines(
            pasted("adjust", self.folder, "--object", name, "--undo", "-o", place),
            pasted("export", self.folder, unused(self.folder, ".ply")),
        )


@dataclass(frozen=True)
class Adjust(EditingCommand):
    """Change how strong a style is, at once and without optimising, or undo it.

    Example: stylesplat adjust garden-wave --intensity 0.6
    """

    intensity: float | None = None
    """0 for the colours before, 1 for the style's, up to 1.5 to exaggerate."""
    form: float | None = None
    """How much of the object's own light and relief shows in the paint, 0 to 1.5."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Adjust or undo this object only. May be repeated."""
    undo: bool = False
    """Remove the paint: write the scene as it was before, to the bit, to the --output folder."""
    picture: bool = True
    """Draw no picture of before and after, which takes longer than the rest."""

    def run(self) -> dict[str, Any]:
        from stylesplat.scene.compose import strengths_of

        if self.undo and self.output is None:
            raise StyleSplatError(
                "Undoing keeps the styled scene. Pass a folder for the other with -o."
            )
        options = {"form": self.form, "objects": self.object, "undo": self.undo}
        result: dict[str, Any] = {"scene": self.folder, "before_after": None}
        with changing(self.folder):
            after = self.rewrite(lambda scene: ss.adjust(scene, self.intensity, **options))
            if after.layers:
                result |= {"intensity": strengths_of(after)}
            if after.layers and self.picture:
                result |= draw_before_after(after, self.folder)
            elif not self.output:
                (self.folder / BEFORE_AFTER).unlink(missing_ok=True)  # of an earlier strength
        if self.form is not None:
            result["form"] = {each.object: each.form for each in after.layers}
        return result

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        painted = result.get("intensity", {})
        if self.undo:
            undone, left = ", ".join(self.object), ", ".join(painted)
            how = f"{undone} as before; {left} as painted" if left else "as before it was painted"
            yield f"{self.folder}: {how}."
        else:
            strengths = (f"{name} at {100 * share:.0f} %" for name, share in painted.items())
            yield f"{self.folder}: {', '.join(strengths)} of the style."
        yield from before_after_line(result)
        yield from next_lines(pasted("export", self.folder, unused(self.folder, ".ply")))

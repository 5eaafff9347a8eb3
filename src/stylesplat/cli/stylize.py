"""`stylesplat stylize`; `recolor`, without a style; `adjust`, how strong paint is; `sheet`."""

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

import stylesplat as ss
from stylesplat.cli.arguments import from_config, parse_style
from stylesplat.cli.command import (
    BEFORE_AFTER,
    Answer,
    Device,
    EditingCommand,
    Features,
    MakingCommand,
    Output,
    StylePreset,
    Weights,
    draw_before_after,
    new_scene,
    next_command,
)
from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.atomic import locked_folder
from stylesplat.progress import say
from stylesplat.runtime import tidy_heap
from stylesplat.stylization.config import RecolorConfig, StyleConfig

if TYPE_CHECKING:
    from stylesplat.stylization.style import Recipe

STYLE_SETTINGS = from_config(StyleConfig)
SHOWN = ("intensity", "form")  # settings that a recipe may give another value after painting


@dataclass(frozen=True)
class Stylize(MakingCommand):
    """Repaint objects of a scene, each in the style of a picture; or a mesh, in its texture.

    Example: stylesplat stylize garden-scene --style vase=wave.jpg -o garden-wave

    Example: stylesplat stylize model.glb --style wave.jpg -o painted.glb
    """

    scene: Annotated[Positional[Path], arg(help="Folder of the scene; or a .glb, .obj or .ply.")]
    output: Output
    """Folder of the styled scene to make; of a mesh a .glb, or of .obj and .ply an .obj."""
    style: UseAppendAction[tuple[str, ...]] = ()
    """OBJECT=IMAGE or OBJECT=IMAGE,IMAGE; OBJECT is a name that `select` gave, or a label id, IMAGE
    a file or a material (material:bronze, marble, gold-leaf, clay or jade). May be repeated. Of a
    mesh OBJECT is a node or material; IMAGE alone paints all of it."""
    recipe: Path | None = None
    """YAML file with objects, styles and settings instead of --style; options given here override
    its own. A styled scene's recipe.json is one too."""
    protect: UseAppendAction[tuple[str, ...]] = ()
    """Name of an object that gets no paint, such as the eyes of a face (`select --of` makes such
    parts). May be repeated."""
    settings: Annotated[dict[str, Any], STYLE_SETTINGS] = field(default_factory=dict)
    preset: StylePreset = "default"
    features: Features = None
    weights: Weights = None
    texture_size: int | None = None
    """Of a mesh: pixels of a side of its texture, a power of two; by default 2048."""
    device: Device = "auto"

    def run(self) -> Answer:
        from stylesplat.io.models.model_files import is_model

        return self._run_mesh() if is_model(self.scene) else self._run_scene()

    def _run_mesh(self) -> Answer:
        from stylesplat.verbs.stylize_mesh import WHOLE_MESH, stylize_mesh

        self.refuse_given(("recipe", "protect"), "a mesh")
        settings = {"preset": self.preset, **self.settings}
        texts = [text if "=" in text else f"{WHOLE_MESH}={text}" for text in self.style]
        styles = {name: ss.Style(*files, **settings) for name, files in map(parse_style, texts)}
        if not styles or (WHOLE_MESH in styles and len(texts) > 1):
            raise StyleSplatError(
                f"A mesh takes --style IMAGE, or --style NAME=IMAGE for parts of it; got "
                f"{' '.join(self.style) or 'none'}."
            )
        options = {"features": self.features, "weights": self.weights, "device": self.device}
        if self.texture_size is not None:
            options["texture_size"] = self.texture_size
        found = stylize_mesh(
            self.scene,
            styles.get(WHOLE_MESH, styles),
            self.output,
            overwrite=self.overwrite,
            **options,
        )
        sides = ", ".join(f"{side} x {side}" for side in found["pictures"])
        unwrapped = f", {found['unwrapped']:,} of them at new UVs" if found["unwrapped"] else ""
        faces = f"{found['faces']:,} faces painted{unwrapped}"
        lines = [f"{self.output}: {faces}, in {found['seconds']:.0f} s. Textures: {sides}."]
        return Answer({"mesh": self.output, **found}, lines)

    def _run_scene(self) -> Answer:
        self.refuse_given(("texture_size",), "a scene")
        from stylesplat.evaluation.summary import style_lines
        from stylesplat.io.scene_folder import revise

        recipe, picture = self._recipe(), Answer({})
        with new_scene(self.output, overwrite=self.overwrite) as save:

            def on_painted(scene: "ss.Scene") -> None:
                nonlocal picture
                save(scene)
                say(f"The painted scene is in {self.output}. Measuring and drawing are left to do.")
                tidy_heap()
                picture = draw_before_after(scene, self.output, device=self.device)
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
        softer = next_command("adjust", self.output, "--intensity", 0.7, ending="-softer")
        measured = style_lines(numbers, numbers["seconds_by_object"])
        return Answer(
            {"scene": self.output, **picture.values, **numbers},
            [f"{self.output}: painted.", *picture.lines, *measured],
            [softer, next_command("export", self.output)],
        )

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
        if self.settings and not recipe.objects:
            option = next(iter(self.settings)).replace("_", "-")
            fact = f"{self.recipe} recolors only, for which --{option} means nothing."
            raise StyleSplatError(f"{fact} Leave it out.")
        for each in recipe.objects:
            before = {"config": each.style.config, "preset": each.style.preset}
            style = ss.Style(*each.style.pictures, **before, **self.settings)
            shown = {name: self.settings.get(name, getattr(each, name)) for name in SHOWN}
            objects.append(replace(each, style=style, **shown))
        return replace(recipe, objects=tuple(objects))


@dataclass(frozen=True)
class Recolor(EditingCommand):
    """Change the colours of an object or of the background, at once and without a style.

    Example: stylesplat recolor garden-scene --object vase --hue 120

    Example: stylesplat recolor garden-scene --object vase --swap "#a02020=teal"
    """

    object: UseAppendAction[tuple[str, ...]] = ()
    """A name or a label id; background is what belongs to no object. May be repeated."""
    settings: Annotated[dict[str, Any], from_config(RecolorConfig)] = field(default_factory=dict)
    strength: float = 1.0
    """How much of the change to blend in, 0 to 1.5."""

    def run(self) -> Answer:
        def change(scene: "ss.Scene") -> "ss.Scene":
            return ss.recolor(scene, self.object, strength=self.strength, **self.settings)

        with locked_folder(self.folder):
            picture = draw_before_after(self.rewrite(change), self.folder)
        options = ("--object", f"{self.object[0]}/recolor", "--undo")
        undo = next_command("adjust", self.folder, *options, ending="-before")
        return Answer(
            {"scene": self.folder, "recolored": list(self.object), **picture.values},
            [f"{self.folder}: {', '.join(self.object)} recoloured.", *picture.lines],
            [undo, next_command("export", self.folder)],
        )


@dataclass(frozen=True)
class Adjust(EditingCommand):
    """Change how strong a style is, at once and without optimising, or undo it.

    Example: stylesplat adjust garden-wave --intensity 0.6
    """

    intensity: float | None = None
    """0 for the colours before, 1 for the style's, up to 1.5 to exaggerate."""
    form: float | None = None
    """How much of the object's own light and relief shows in the paint, 0 to 1.5; above 1 strokes
    give way to it."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Adjust or undo this object only. May be repeated."""
    undo: bool = False
    """Remove the paint: write the scene as it was before, to the bit, to the --output folder."""
    picture: bool = True
    """Draw no picture of before and after; drawing takes longer than the rest."""

    def run(self) -> Answer:
        from stylesplat.scene.scene import strengths_of

        if self.undo and self.output is None:
            raise StyleSplatError(
                "Undoing keeps the styled scene. Pass a folder for the other with -o."
            )
        options = {"form": self.form, "objects": self.object, "undo": self.undo}
        picture = Answer({"before_after": None})
        with locked_folder(self.folder):
            after = self.rewrite(lambda scene: ss.adjust(scene, self.intensity, **options))
            if after.layers and self.picture:
                picture = draw_before_after(after, self.folder)
            elif not self.output:
                (self.folder / BEFORE_AFTER).unlink(missing_ok=True)  # of an earlier strength
        painted = strengths_of(after) if after.layers else {}
        values: dict[str, Any] = {"scene": self.folder, **picture.values}
        if painted:
            values["intensity"] = painted
        if self.form is not None:
            values["form"] = {each.object: each.form for each in after.layers}
        if self.undo:
            undone, left = ", ".join(self.object), ", ".join(painted)
            how = f"{undone} as before; {left} as painted" if left else "as before it was painted"
        else:
            strengths = (f"{name} at {100 * share:.0f} %" for name, share in painted.items())
            how = f"{', '.join(strengths)} of the style"
        lines = [f"{self.folder}: {how}.", *picture.lines]
        return Answer(values, lines, [next_command("export", self.folder)])


VARIED_OPTIONS = ("preset", "stroke_size", *STYLE_SETTINGS.__annotations__)  # options of `stylize`


@dataclass(frozen=True)
class Sheet(MakingCommand):
    """Draw an object in a grid of styles and settings, to choose from.

    Example: stylesplat sheet garden-scene -o sheet.png --style vase=wave.jpg --vary
    stroke_size=1,2,4
    """

    scene: Positional[Path]
    """Folder of the scene, which stays as it is."""
    output: Output
    """Picture to make."""
    style: UseAppendAction[tuple[str, ...]] = ()
    """OBJECT=IMAGE or OBJECT=IMAGE,IMAGE. May be repeated with other pictures for the same
    object, which are the rows then."""
    vary: UseAppendAction[tuple[str, ...]] = ()
    """KEY=VALUE,VALUE: makes columns, or rows if it is given a second time. KEY is an option of
    `stylize`, such as stroke_size or color; lists take brackets: region=[0,0,99,99],null."""
    pick: str | None = None
    """ROW,COLUMN of a cell, as its caption begins: print the command that paints it, and draw
    nothing."""
    view: str | None = None
    """Name of the photo to look from; by default the one that shows most of the object."""
    preset: StylePreset = "default"
    settings: Annotated[dict[str, Any], from_config(StyleConfig, "steps", "seed")] = field(
        default_factory=dict
    )
    features: Features = None
    weights: Weights = None
    device: Device = "auto"

    def run(self) -> Answer:
        variations = self._variations()
        commands = self._commands(variations)
        cells = {
            f"{row},{column}": command
            for row, line in enumerate(commands, 1)
            for column, command in enumerate(line, 1)
        }
        if self.pick is not None:
            check_choice(self.pick, "cell", cells)
            return Answer({"command": cells[self.pick]}, [cells[self.pick]])
        from stylesplat.io.images import write_image

        preset = {} if self.preset == "default" else {"preset": self.preset}
        with locked_folder(self.output):
            self.refuse_picture(self.output)
            made = ss.sheet(
                ss.open(self.scene),
                parse_style(self.style[0])[0],
                [pictures for _, pictures in map(parse_style, self.style)],
                vary=variations,
                view=self.view,
                features=self.features,
                weights=self.weights,
                device=self.device,
                **preset,
                **self.settings,
            )
            write_image(made.picture, self.output)
        values = {"sheet": self.output, "view": made.view, "cells": made.cells}
        values |= {"repainted": made.repainted, "commands": commands}
        lines = (
            f"{self.output}: {made.cells} pictures, seen from {made.view}.",
            "To paint the scene like one of the cells (--pick ROW,COLUMN prints its line again):",
            *(f"{cell}:  {command}" for cell, command in cells.items()),
        )
        return Answer(values, lines)

    def _variations(self) -> dict[str, tuple[Any, ...]]:
        """The values of each option that varies."""
        from stylesplat.stylization.recipe import parse_variation

        names = list(dict.fromkeys(parse_style(text)[0] for text in self.style))
        if len(names) != 1:
            got = " and ".join(names) or "none"
            raise StyleSplatError(
                f"A sheet shows one object, got {got}. Pass --style OBJECT=IMAGE."
            )
        found: dict[str, tuple[Any, ...]] = {}
        for text in self.vary:
            name, equals, values = text.partition("=")
            key = {"scale": "stroke_size"}.get(name, name.replace("-", "_"))  # its other name
            if equals:
                check_choice(key, "option of `stylize` to vary,", VARIED_OPTIONS)
            if key in found:
                raise StyleSplatError(f"--vary {name} was given twice. List all its values in one.")
            _, found[key] = parse_variation(f"{key}{equals}{values}")
        return found

    def _commands(self, variations: dict[str, tuple[Any, ...]]) -> list[list[str]]:
        """The command that paints each cell, by row and column."""
        networks = {"features": self.features, "weights": self.weights}
        shared = {"preset": self.preset, **networks, **self.settings}
        axes = [[(key, value) for value in values] for key, values in variations.items()]
        columns, *others = axes or [[("preset", self.preset)]]
        return [
            [self._command(style, {**shared, **dict((column, *chosen))}) for column in columns]
            for style, chosen in product(self.style, product(*others))
        ]

    def _command(self, style: str, options: dict[str, Any]) -> str:
        words: list[object] = ["--style", style]
        for key, value in options.items():
            if value is not None and (key, value) != ("preset", "default"):
                values = value if isinstance(value, tuple) else (value,)
                shown = (f"{each:g}" if isinstance(each, float) else each for each in values)
                words += [f"--{key.replace('_', '-')}", *shown]
        return next_command("stylize", self.scene, *words)

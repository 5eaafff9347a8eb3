"""`stylesplat sheet`."""

from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction

from stylesplat.cli.arguments import from_config, parse_style
from stylesplat.cli.options import Device, Features, MakingCommand, Output, StylePreset, Weights
from stylesplat.cli.results import Answer, next_command
from stylesplat.cli.stylize import SETTINGS
from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.stylization.config import StyleConfig

VARIED = ("preset", "stroke_size", *SETTINGS.__annotations__)  # options of `stylize`


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
        drawn = self._draw(variations)
        lines = (
            f"{self.output}: {drawn['cells']} pictures, seen from {drawn['view']}.",
            "To paint the scene like one of the cells (--pick ROW,COLUMN prints its line again):",
            *(f"{cell}:  {command}" for cell, command in cells.items()),
        )
        return Answer({**drawn, "commands": commands}, lines)

    def _draw(self, variations: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
        from stylesplat.io.atomic import changing
        from stylesplat.io.images import write_image
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.sheet import sheet

        preset = {} if self.preset == "default" else {"preset": self.preset}
        with changing(self.output):
            self.refuse_picture(self.output)
            made = sheet(
                open(self.scene),
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
        counts = {"cells": made.cells, "repainted": made.repainted}
        return {"sheet": self.output, "view": made.view, **counts}

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
                check_choice(key, "option of `stylize` to vary,", VARIED)
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

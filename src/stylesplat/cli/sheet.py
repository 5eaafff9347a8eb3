"""`stylesplat sheet`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction

from stylesplat.cli.next_steps import next_lines, pasted, unused
from stylesplat.cli.options import Device, Json, Output, Overwrite, Verbose, given, refuse_picture
from stylesplat.cli.parse import parse_style
from stylesplat.cli.results import write_or_rescue
from stylesplat.errors import StyleSplatError
from stylesplat.stylization.style_config import DEFAULT_NETWORK, Network


@dataclass(frozen=True)
class Sheet:
    """Draw an object in a grid of styles and settings, to choose from.

    Example: stylesplat sheet garden-scene -o sheet.png --style vase=wave.jpg --vary scale=1,2,4
    """

    first: ClassVar = ("style", "vary")
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
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.recovery import changing

        with changing(self.output):
            return self._draw()

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{self.output}: {result['cells']} pictures, seen from {result['view']}."
        yield "With the settings that you like, in the spelling of `stylize --help`:"
        chosen = ["--style", self.style[0], "-o", unused(self.scene, "-painted")]
        yield from next_lines(pasted("stylize", self.scene, *chosen))

    def _draw(self) -> dict[str, Any]:
        from stylesplat.io.images import write_image
        from stylesplat.io.scene_folder import open
        from stylesplat.stylization.recipe import parse_variation
        from stylesplat.verbs.sheet import sheet

        refuse_picture(self.output, overwrite=self.overwrite)
        styles = [parse_style(text) for text in self.style]
        names = list(dict.fromkeys(name for name, _ in styles))
        if len(names) != 1:
            got = " and ".join(names) or "none"
            raise StyleSplatError(
                f"A sheet shows one object, got {got}. Pass --style OBJECT=IMAGE."
            )
        vary = [parse_variation(text) for text in self.vary]
        keys = [key for key, _ in vary]
        if len(set(keys)) < len(keys):
            twice = next(key for key in keys if keys.count(key) > 1)
            raise StyleSplatError(f"--vary {twice} was given twice. List all its values in one.")
        made = sheet(
            open(self.scene),
            names[0],
            [pictures for _, pictures in styles],
            vary=dict(vary),
            view=self.view,
            features=self.features,
            weights=self.weights,
            device=self.device,
            preset=self.preset,
            **given(self, ("steps", "seed")),
        )
        write_or_rescue(
            lambda place, _: write_image(made.picture, place),
            self.output,
            overwrite=self.overwrite,
            what="The sheet is",
        )
        counts = {"cells": made.cells, "repainted": made.repainted}
        return {"sheet": self.output, "view": made.view, **counts}

"""`stylesplat sheet`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction

from stylesplat.cli.next_steps import next_lines, pasted, unused
from stylesplat.cli.options import (
    CONTINUES,
    Device,
    Json,
    Output,
    Overwrite,
    Verbose,
    given,
    refuse_picture,
)
from stylesplat.cli.parse import parse_style
from stylesplat.cli.results import write_or_rescue
from stylesplat.errors import StyleSplatError
from stylesplat.signals import WHOLE
from stylesplat.stylization.config import Network

if TYPE_CHECKING:
    from stylesplat.verbs.sheet import Sheet as Drawn


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
    """Settings to start from; paper is the method as published, with --features vgg16."""
    steps: int | None = None
    """Optimiser steps per cell."""
    features: Network | None = None
    """Network whose features are matched, by default compact, which ships with the package; vgg16
    for --preset paper."""
    weights: Path | None = None
    """File of the network's weights (.safetensors, .pth); VGG's are else downloaded, once."""
    seed: int | None = None
    """The same seed and number of threads give the same result."""
    cells: Path | None = None
    """Folder to keep the painted scenes in, each painted by a process of its own. What is there
    already is not painted again: an interrupted sheet goes on."""
    workers: int | None = None
    """With --cells, processes at a time, each with its share of the cores."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    @property
    def after_interruption(self) -> str:
        """How to go on."""
        return WHOLE if self.cells is None else CONTINUES

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.recovery import changing

        with changing(self.output):
            return self._draw()

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{self.output}: {result['cells']} pictures, seen from {result['view']}."
        if self.cells is not None:
            yield f"The painted scenes are in {self.cells}: what you like is there."
        yield "With the settings that you like, in the spelling of `stylize --help`:"
        chosen = ["--style", self.style[0], "-o", unused(self.scene, "-painted")]
        yield from next_lines(pasted("stylize", self.scene, *chosen))

    def _draw(self) -> dict[str, Any]:
        from stylesplat.io.images import write_image

        refuse_picture(self.output, overwrite=self.overwrite)
        if self.workers is not None and self.cells is None:
            raise StyleSplatError("--workers means nothing without --cells. Add --cells FOLDER.")
        name, styles = self._styles()
        made = (self._at_once if self.cells is None else self._by_cells)(name, styles)
        write_or_rescue(
            lambda place, _: write_image(made.picture, place),
            self.output,
            overwrite=self.overwrite,
            what="The sheet is",
        )
        counts = {"cells": made.cells, "repainted": made.repainted}
        return {"sheet": self.output, "view": made.view, **counts}

    def _at_once(self, name: str, styles: list[tuple[Path, ...]]) -> "Drawn":
        """Painted in this process."""
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.sheet import sheet

        return sheet(
            open(self.scene),
            name,
            styles,
            vary=self._variations(),
            view=self.view,
            features=self.features,
            weights=self.weights,
            device=self.device,
            **self._settings,
        )

    def _by_cells(self, name: str, styles: list[tuple[Path, ...]]) -> "Drawn":
        """Painted by processes of their own, whose results are kept."""
        from stylesplat.cli.sheet_cells import Cells
        from stylesplat.figures.style_sheet import plan_sheet
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.sheet import sheet_of

        assert self.cells is not None
        vary = self._variations()
        plan = plan_sheet(styles, [*vary.items()], settings=self._settings)
        how = {"device": self.device, **self._settings}
        how |= {"features": self.features} if self.features else {}
        how |= {"weights": str(self.weights)} if self.weights else {}
        cells = Cells(self.scene, name, styles, vary, how)
        painted = cells.painted(self.cells, 1 if self.workers is None else self.workers)
        scene = open(self.scene)
        return sheet_of(scene, name, plan, painted, view=self.view, device=self.device)

    @property
    def _settings(self) -> dict[str, Any]:
        """Those of all cells."""
        return {"preset": self.preset, **given(self, ("steps", "seed"))}

    def _styles(self) -> tuple[str, list[tuple[Path, ...]]]:
        """The object, and the pictures of each style."""
        styles = [parse_style(text) for text in self.style]
        names = list(dict.fromkeys(name for name, _ in styles))
        if len(names) != 1:
            got = " and ".join(names) or "none"
            raise StyleSplatError(
                f"A sheet shows one object, got {got}. Pass --style OBJECT=IMAGE."
            )
        return names[0], [pictures for _, pictures in styles]

    def _variations(self) -> dict[str, tuple[Any, ...]]:
        """What is varied."""
        from stylesplat.stylization.recipe import parse_variation

        vary = [parse_variation(text) for text in self.vary]
        keys = [key for key, _ in vary]
        if len(set(keys)) < len(keys):
            twice = next(key for key in keys if keys.count(key) > 1)
            raise StyleSplatError(f"--vary {twice} was given twice. List all its values in one.")
        return dict(vary)

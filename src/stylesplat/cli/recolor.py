"""`stylesplat recolor`."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction

import stylesplat as ss
from stylesplat.cli.arguments import from_config
from stylesplat.cli.options import MakingCommand, NewScene
from stylesplat.cli.results import (
    before_after_line,
    draw_before_after,
    next_lines,
    pasted,
    rewrite_scene,
    unused,
)
from stylesplat.io.atomic import changing
from stylesplat.stylization.config import RecolorConfig

SETTINGS = from_config(RecolorConfig, *vars(RecolorConfig()))


@dataclass(frozen=True)
class Recolor(MakingCommand):
    """Change the colours of an object or of the background, at once and without a style.

    Example: stylesplat recolor garden-scene --object vase --hue 120
    """

    scene: Positional[Path]
    """Folder of the scene."""
    output: NewScene = None
    object: UseAppendAction[tuple[str, ...]] = ()
    """A name or a label id; background is what belongs to no object. May be repeated."""
    settings: Annotated[dict[str, Any], SETTINGS] = field(default_factory=dict)
    strength: float = 1.0
    """How much of the change to blend in, 0 to 1.5."""

    def run(self) -> dict[str, Any]:
        folder = self.output or self.scene
        with changing(folder):
            after = rewrite_scene(
                self.scene,
                self.output,
                lambda scene: ss.recolor(
                    scene, self.object, strength=self.strength, **self.settings
                ),
                overwrite=self.overwrite,
            )
            picture = draw_before_after(after, folder)
        return {"scene": folder, "recolored": list(self.object), **picture}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        yield f"{result['scene']}: {', '.join(self.object)} recoloured."
        yield from before_after_line(result)
        scene, name = Path(result["scene"]), f"{self.object[0]}/recolor"
        yield from next_lines(
            pasted("adjust", scene, "--object", name, "--undo", "-o", unused(scene, "-before")),
            pasted("export", scene, unused(scene, ".ply")),
        )

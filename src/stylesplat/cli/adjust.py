"""`stylesplat adjust`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional, UseAppendAction

import stylesplat as ss
from stylesplat.cli.options import Flag, MakingCommand, NewScene
from stylesplat.cli.results import (
    before_after_line,
    draw_before_after,
    next_lines,
    pasted,
    rewrite_scene,
    unused,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import changing


@dataclass(frozen=True)
class Adjust(MakingCommand):
    """Change how strong a style is, at once and without optimising, or undo it.

    Example: stylesplat adjust garden-wave --intensity 0.6
    """

    scene: Positional[Path]
    """Folder of the styled scene."""
    output: NewScene = None
    intensity: float | None = None
    """0 for the colours before, 1 for the style's, up to 1.5 to exaggerate."""
    form: float | None = None
    """How much of the object's own light and relief shows in the paint, 0 to 1.5."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Adjust or undo this object only. May be repeated."""
    undo: Flag = False
    """Remove the paint: write the scene as it was before, to the bit, to the --output folder."""

    def run(self) -> dict[str, Any]:
        from stylesplat.scene.compose import strengths_of

        if self.undo and self.output is None:
            raise StyleSplatError(
                "Undoing keeps the styled scene. Pass a folder for the other with -o."
            )
        options = {"form": self.form, "objects": self.object, "undo": self.undo}
        folder = self.output or self.scene
        with changing(folder):
            after = rewrite_scene(
                self.scene,
                self.output,
                lambda scene: ss.adjust(scene, self.intensity, **options),
                overwrite=self.overwrite,
            )
            nothing = {"before_after": None}
            picture = draw_before_after(after, folder) if after.layers else nothing
        settings = {"intensity": strengths_of(after)} if after.layers else {}
        if self.form is not None:
            settings["form"] = {each.object: each.form for each in after.layers}
        return {"scene": folder, **settings, **picture}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        painted = result.get("intensity", {})
        if self.undo:
            undone, left = ", ".join(self.object), ", ".join(painted)
            how = f"{undone} as before; {left} as painted" if left else "as before it was painted"
            yield f"{result['scene']}: {how}."
        else:
            strengths = (f"{name} at {100 * share:.0f} %" for name, share in painted.items())
            yield f"{result['scene']}: {', '.join(strengths)} of the style."
        yield from before_after_line(result)
        scene = Path(result["scene"])
        yield from next_lines(pasted("export", scene, unused(scene, ".ply")))

"""`stylesplat adjust`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.next_steps import next_lines, unused
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose
from stylesplat.cli.rewriting import rewritten
from stylesplat.cli.scene_pictures import before_after_line, write_before_after
from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import pasted


@dataclass(frozen=True)
class Adjust:
    """Change how strong a style is, at once and without optimising, or undo it.

    Example: stylesplat adjust garden-wave --intensity 0.6
    """

    first: ClassVar = ("output", "intensity", "form", "object", "undo")
    scene: Positional[Path]
    """Folder of the styled scene."""
    intensity: float | None = None
    """0 for what was before, 1 for the style's, up to 1.5 to exaggerate."""
    form: float | None = None
    """How much of the object's own light and relief shows in the paint, 0 to 1.5."""
    undo: FlagCreatePairsOff[bool] = False
    """Write the scene as it was before it was styled, to the bit, to the --output folder; with
    --object only these are as before."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Adjust or undo this object only. May be repeated."""
    output: OptionalOutput = None
    """Folder of a scene to make; without it the scene itself is changed."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.atomic import changing
        from stylesplat.scene.compose import strengths_of
        from stylesplat.verbs.adjust import adjust

        if self.undo and self.output is None:
            raise StyleSplatError(
                "Undoing keeps the styled scene. Pass a folder for the other with -o."
            )
        folder = self.output or self.scene
        with changing(folder):
            after = rewritten(
                self.scene,
                self.output,
                lambda scene: adjust(
                    scene,
                    self.intensity,
                    form=self.form,
                    objects=self.object,
                    undo=self.undo,
                ),
                overwrite=self.overwrite,
            )
            nothing = {"before_after": None}
            picture = write_before_after(after, folder) if after.layers else nothing
        shown = {"intensity": strengths_of(after)} if after.layers else {}
        if self.form is not None:
            shown["form"] = {each.object: each.form for each in after.layers}
        return {"scene": folder, **shown, **picture}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        painted = result.get("intensity", {})
        if self.undo:
            undone, left = ", ".join(self.object), ", ".join(painted)
            how = f"{undone} as before; {left} as painted" if left else "as before it was painted"
            yield f"{result['scene']}: {how}."
        else:
            shown = (f"{name} at {100 * share:.0f} %" for name, share in painted.items())
            yield f"{result['scene']}: {', '.join(shown)} of the style."
        yield from before_after_line(result)
        scene = Path(result["scene"])
        yield from next_lines(pasted("export", scene, unused(scene, ".ply")))

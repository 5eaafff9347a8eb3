"""`stylesplat adjust`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.options import Json, OptionalOutput, Overwrite
from stylesplat.errors import StyleSplatError


@dataclass(frozen=True)
class Adjust:
    """Change how strong a style is, at once and without optimising, or undo it.

    Example: stylesplat adjust garden-wave --intensity 0.6
    """

    first: ClassVar = ("output", "intensity", "object", "undo")
    scene: Positional[Path]
    """Folder of the styled scene."""
    intensity: float | None = None
    """0 for the colours before, 1 for the style's, up to 1.5 to exaggerate."""
    undo: FlagCreatePairsOff[bool] = False
    """Write the scene as it was before it was styled, to the bit, to the --output folder; with
    --object only these are as before."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Adjust or undo this object only. May be repeated."""
    output: OptionalOutput = None
    """Folder of a scene to make; without it the scene itself is changed."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.folders import refuse_occupied
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import SCENE, open, revise, save
        from stylesplat.verbs.adjust import adjust

        if self.undo and self.output is None:
            raise StyleSplatError(
                "Undoing keeps the styled scene. Pass a folder for the other with -o."
            )
        with changing(self.output or self.scene):
            if self.output is not None:
                refuse_occupied(self.output, marker=SCENE, overwrite=self.overwrite)
            before = open(self.scene)
            after = adjust(before, self.intensity, objects=self.object, undo=self.undo)
            if self.output is None:
                revise(before, after, self.scene)
            else:
                save(after, self.output, overwrite=self.overwrite)
        painted = after.painted.paintings if after.painted else ()
        shown = {"intensity": {each.name: each.intensity for each in painted}} if painted else {}
        return {"scene": self.output or self.scene, **shown}

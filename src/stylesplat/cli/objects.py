"""`stylesplat objects`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.options import Json, OptionalOutput, Overwrite, refuse_picture

SHEET = "objects.png"


@dataclass(frozen=True)
class Objects:
    """List the objects of a scene, say where they are, and draw a contact sheet of them.

    Example: stylesplat objects garden-scene
    """

    first: ClassVar = ("output",)
    scene: Positional[Path]
    """Folder of the scene."""
    output: OptionalOutput = None
    """Picture of the sheet; by default objects.png in the scene, which is replaced."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.drawing.object_sheet import object_sheet
        from stylesplat.io.images import write_image
        from stylesplat.io.places import refuse_file
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import open
        from stylesplat.progress import say
        from stylesplat.selection.identities import UNLABELLED
        from stylesplat.verbs.objects import extents, objects

        if self.output is not None:
            refuse_picture(self.output, overwrite=self.overwrite)
        scene = open(self.scene)
        scene = open(self.scene)
        if scene.splats.classifier is None:
            say(f"No objects are known. {UNLABELLED}")
            return {"objects": [], "sheet": None, **extents(scene)}
        refuse_file(self.scene / SHEET, overwrite=True)
        found = objects(scene)
        names = {each["id"]: ", ".join(each["names"]) for each in found if each["names"]}
        sheet = object_sheet(scene.splats, scene.cameras, names=names)
        target = self.output or self.scene / SHEET
        with changing(self.output or self.scene):
            write_image(sheet, target)
        return {"objects": found, "sheet": target, **extents(scene)}

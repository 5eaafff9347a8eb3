"""`stylesplat objects`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from stylesplat.cli.options import Json

SHEET = "objects.png"


@dataclass(frozen=True)
class Objects:
    """List the objects of a scene, say where they are, and draw a contact sheet of them.

    Example: stylesplat objects garden-scene
    """

    scene: Positional[Path]
    """Folder of the scene; the sheet is written there as objects.png."""
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.drawing.object_sheet import object_sheet
        from stylesplat.io.images import write_image
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import open
        from stylesplat.progress import say
        from stylesplat.selection.identities import UNLABELLED
        from stylesplat.verbs.objects import extents, objects

        scene = open(self.scene)
        if scene.splats.classifier is None:
            say(f"No objects are known. {UNLABELLED}")
            return {"objects": [], "sheet": None, **extents(scene)}
        found = objects(scene)
        names = {each["id"]: ", ".join(each["names"]) for each in found if each["names"]}
        sheet = object_sheet(scene.splats, scene.cameras, names=names)
        with changing(self.scene):
            write_image(sheet, self.scene / SHEET)
        return {"objects": found, "sheet": self.scene / SHEET, **extents(scene)}

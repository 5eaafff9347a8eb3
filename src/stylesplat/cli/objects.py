"""`stylesplat objects`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.next_steps import next_lines, object_commands
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose, refuse_picture

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
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.figures.sheets import object_sheet
        from stylesplat.io.atomic import changing, refuse_file
        from stylesplat.io.images import write_image
        from stylesplat.io.scene_folder import open
        from stylesplat.progress import say
        from stylesplat.selection.identities import UNLABELLED
        from stylesplat.verbs.objects import extents, objects

        if self.output is not None:
            refuse_picture(self.output, overwrite=self.overwrite)
        scene = open(self.scene)
        if scene.splats.classifier is None:
            say(f"No objects are known, so there is no sheet. {UNLABELLED}")
            return {"objects": [], "sheet": None, **extents(scene)}
        if self.output is None:
            refuse_file(self.scene / SHEET, overwrite=True)
        found = objects(scene)
        names = {each["id"]: ", ".join(each["names"]) for each in found if each["names"]}
        sheet = object_sheet(scene.splats, scene.cameras, names=names)
        target = self.output or self.scene / SHEET
        with changing(self.output or self.scene):
            write_image(sheet, target)
        return {"objects": found, "sheet": target, **extents(scene)}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What there is, a line each, and how to go on."""
        from stylesplat.scene.one_line import counted

        named, ids = result["named"], dict[str, int]()
        for each in result["objects"]:
            ids |= dict.fromkeys(each["names"], each["id"])
            same = [
                name
                for name in each["names"]
                if named.get(name, each)["gaussians"] == each["gaussians"]
            ]
            named = {name: place for name, place in named.items() if name not in same}
            called = ", ".join([f"id {each['id']}", *same])
            sure = f", {each['confidence']:.0%} sure" if "confidence" in each else ""
            own = f", {each['own']:,} its own"
            yield f"{called}: {counted(each['gaussians'], 'Gaussian')}{own}{sure}{_where(each)}"
        for name, place in named.items():  # unions, parts, and what a style has changed
            called = f"{name} (id {ids[name]})" if name in ids else name
            yield f"{called}: {counted(place['gaussians'], 'Gaussian')}{_where(place)}"
        yield f"all content{_where(result['content'])}"
        if result["sheet"]:
            yield f"Picture: {result['sheet']}"
        if result["named"] or result["objects"]:  # else it was said how to make some
            names = [*result["named"]]
            yield from next_lines(object_commands(self.scene, names, labelled=True)[-1])


def _where(place: dict[str, Any]) -> str:
    """Its box, as `--box3d` takes it."""
    if "box" not in place:
        return ""
    return f", --box3d={','.join(f'{number:.3g}' for number in place['box'])}"

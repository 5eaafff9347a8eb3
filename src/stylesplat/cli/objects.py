"""`stylesplat objects`, `rename` and `delete`: the objects of a scene, and their names."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.options import MakingCommand, NewScene, OptionalOutput, refuse_picture
from stylesplat.cli.results import next_lines, object_commands, rewrite_scene, stylize_command
from stylesplat.io.atomic import changing, refuse_file
from stylesplat.io.files import file_stem, inside
from stylesplat.progress import say

SHEET = "objects.png"
PICTURES = "selections"  # the folder inside a scene


def selection_file(scene: Path, name: str) -> Path:
    """The picture of a selection.

    Raises:
        StyleSplatError: If the folder of pictures leads out of the scene.
    """
    return inside(scene, f"{PICTURES}/{file_stem(name)}.png")


@dataclass(frozen=True)
class Objects(MakingCommand):
    """List the objects of a scene, say where they are, and draw a contact sheet of them.

    Example: stylesplat objects garden-scene
    """

    scene: Positional[Path]
    """Folder of the scene."""
    output: OptionalOutput = None
    """Picture of the sheet; by default objects.png in the scene, which is replaced."""

    def run(self) -> dict[str, Any]:
        from stylesplat.figures.sheets import object_sheet
        from stylesplat.io.images import write_image
        from stylesplat.selection.identities import UNLABELLED
        from stylesplat.verbs.objects import extents

        if self.output is not None:
            refuse_picture(self.output, overwrite=self.overwrite)
        scene = ss.open(self.scene)
        if scene.splats.classifier is None:
            say(f"No objects are known, so there is no sheet. {UNLABELLED}")
            return {"objects": [], "sheet": None, **extents(scene)}
        if self.output is None:
            refuse_file(self.scene / SHEET, overwrite=True)
        found = ss.objects(scene)
        names = {each["id"]: ", ".join(each["names"]) for each in found if each["names"]}
        target = self.output or self.scene / SHEET
        with changing(self.output or self.scene):
            write_image(object_sheet(scene.splats, scene.cameras, names=names), target)
        return {"objects": found, "sheet": target, **extents(scene)}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        from stylesplat.scene.one_line import counted

        named, ids = dict(result["named"]), dict[str, int]()
        for each in result["objects"]:
            own, count = each["own"], each["gaussians"]
            same = [n for n in each["names"] if n in named and named[n]["gaussians"] == count]
            for name in same:  # one line for both
                del named[name]
            ids |= dict.fromkeys(each["names"], each["id"])
            called = ", ".join([f"id {each['id']}", *same])
            sure = f", {each['confidence']:.0%} sure" if "confidence" in each else ""
            yield f"{called}: {counted(count, 'Gaussian')}, {own:,} its own{sure}{_box(each)}"
        for name, place in named.items():  # unions, parts, and what a style has changed
            called = f"{name} (id {ids[name]})" if name in ids else name
            yield f"{called}: {counted(place['gaussians'], 'Gaussian')}{_box(place)}"
        yield f"all content{_box(result['content'])}"
        if result["sheet"]:
            yield f"Picture: {result['sheet']}"
        if result["named"] or result["objects"]:
            names = [*result["named"]]
            yield from next_lines(object_commands(self.scene, names, labelled=True)[-1])


def _box(place: dict[str, Any]) -> str:
    if "box" not in place:
        return ""
    return f", --box3d={','.join(f'{number:.3g}' for number in place['box'])}"


@dataclass(frozen=True)
class Rename(MakingCommand):
    """Give an object of a scene another name.

    Example: stylesplat rename garden-scene object vase
    """

    scene: Positional[Path]
    """Folder of the scene."""
    old: Positional[str]
    """The object's name."""
    new: Positional[str]
    """Its new name."""
    output: NewScene = None

    def run(self) -> dict[str, Any]:
        folder = self.output or self.scene
        picture, target = selection_file(self.scene, self.old), selection_file(folder, self.new)
        with changing(folder):
            after = rewrite_scene(
                self.scene,
                self.output,
                lambda scene: ss.rename(scene, self.old, self.new),
                overwrite=self.overwrite,
            )
            has_picture = self.output is None and picture.is_file()
            if has_picture:
                picture.replace(target)
        found = {"name": self.new, "was": self.old, **after.objects[self.new].how}
        return found | {"scene": folder, "picture": target if has_picture else None}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        yield f"{result['was']} is called {result['name']} now."
        yield from next_lines(stylize_command(result["scene"], self.new))


@dataclass(frozen=True)
class Delete(MakingCommand):
    """Delete the name of an object; its Gaussians stay, and so does their paint.

    Example: stylesplat delete garden-scene lid
    """

    scene: Positional[Path]
    """Folder of the scene."""
    name: Positional[str]
    """The object's name."""
    output: NewScene = None

    def run(self) -> dict[str, Any]:
        folder = self.output or self.scene
        picture = selection_file(folder, self.name)
        with changing(folder):
            after = rewrite_scene(
                self.scene,
                self.output,
                lambda scene: ss.delete(scene, self.name),
                overwrite=self.overwrite,
            )
            picture.unlink(missing_ok=True)
        return {"scene": folder, "deleted": self.name, "names": [*after.objects]}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        left = ", ".join(result["names"]) or "none"
        yield f"{result['scene']}: deleted the name {result['deleted']!r}. Names: {left}."

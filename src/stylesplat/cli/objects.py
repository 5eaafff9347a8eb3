"""`stylesplat objects`, `select`, `rename` and `delete`: a scene's objects."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from inspect import signature
from itertools import chain
from pathlib import Path
from typing import Any

from tyro.conf import Positional, UseAppendAction

import stylesplat as ss
from stylesplat.cli.command import (
    Answer,
    EditingCommand,
    MakingCommand,
    OptionalOutput,
    SceneFolder,
    object_commands,
    optional_picture,
    selection_file,
    stylize_command,
)
from stylesplat.io.atomic import locked_folder, refuse_file
from stylesplat.options import PickSize
from stylesplat.progress import say

SHEET = "objects.png"


@dataclass(frozen=True)
class Objects(MakingCommand):
    """List the objects of a scene, say where they are, and draw a contact sheet of them.

    Example: stylesplat objects garden-scene
    """

    scene: SceneFolder
    output: OptionalOutput = None
    """Picture of the sheet; by default objects.png in the scene, which is replaced."""

    def run(self) -> Answer:
        from stylesplat.figures.sheets import object_sheet
        from stylesplat.io.images import write_image
        from stylesplat.selection.labels import UNLABELLED
        from stylesplat.verbs.objects import extents

        if self.output is not None:
            self.refuse_picture(self.output)
        scene, found, sheet = ss.open(self.scene), list[dict[str, Any]](), None
        if scene.splats.classifier is None:
            say(f"No objects are known, so there is no sheet. {UNLABELLED}")
        else:
            if self.output is None:
                refuse_file(self.scene / SHEET, overwrite=True)
            found, sheet = ss.objects(scene), self.output or self.scene / SHEET
            names = {each["id"]: ", ".join(each["names"]) for each in found if each["names"]}
            with locked_folder(self.output or self.scene):
                write_image(object_sheet(scene.splats, scene.cameras, names=names), sheet)
        places = extents(scene)
        lines = [*_object_lines(found, places)]
        if sheet is not None:
            lines.append(f"Picture: {sheet}")
        commands = object_commands(self.scene, [*places["named"]], labelled=True)
        following = commands[-1:] if found or places["named"] else []
        return Answer({"objects": found, "sheet": sheet, **places}, lines, following)


def _object_lines(objects: list[dict[str, Any]], places: dict[str, Any]) -> Iterator[str]:
    from stylesplat.errors import count_noun

    named, ids = dict(places["named"]), dict[str, int]()
    for each in objects:
        own, count = each["own"], each["gaussians"]
        same = [n for n in each["names"] if n in named and named[n]["gaussians"] == count]
        for name in same:  # one line for both
            del named[name]
        ids |= dict.fromkeys(each["names"], each["id"])
        called = ", ".join([f"id {each['id']}", *same])
        sure = f", {each['confidence']:.0%} sure" if "confidence" in each else ""
        yield f"{called}: {count_noun(count, 'Gaussian')}, {own:,} its own{sure}{_box(each)}"
    for name, place in named.items():  # unions, parts, and what a style has changed
        called = f"{name} (id {ids[name]})" if name in ids else name
        yield f"{called}: {count_noun(place['gaussians'], 'Gaussian')}{_box(place)}"
    yield f"all content{_box(places['content'])}"


def _box(place: dict[str, Any]) -> str:
    if "box" not in place:
        return ""
    # Three digits of the box's size, and those in front of them
    size = max(place["size"])
    digits = [3 + int(math.log10(max(abs(number) / size, 1))) for number in place["box"]]
    numbers = zip(place["box"], digits, strict=True)
    return f", --box3d={','.join(f'{number:.{most}g}' for number, most in numbers)}"


@dataclass(frozen=True)
class Select(EditingCommand):
    """Name an object of a scene, by label id, places in photos, words, or a shape in the world.

    Several choices are united: `--id 3 --plus lid --minus lamp`.

    Example: stylesplat select garden-scene --name vase --point IMG_0007.jpg:640,420
    """

    name: str
    """The object's name."""
    id: UseAppendAction[tuple[tuple[int, ...], ...]] = ()
    """Label ids, as `objects` lists them, several or one at a time."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x0,y0,x1,y1 in the photo's pixels at full size: the object that shows most inside. May
    be repeated."""
    point: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x,y in the photo's pixels: the object that shows there. May be repeated."""
    not_point: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x,y of an object that does not belong to the selection. May be repeated."""
    of: str | None = None
    """The name of the object that this is a part of: what of the selection lies on it becomes the
    part, and the rest stays the object's."""
    size: PickSize | None = None
    """How much a point means in a scene without labels: a part that folds or other colours bound,
    also flat on a wall (the default with --of), an object (otherwise), or all that touches. In a
    scene with labels, instead of these."""
    text: UseAppendAction[tuple[str, ...]] = ()
    """A few words: the object that they mean, if it is clear which one. May be repeated."""
    model: str | None = None
    """Folder or hub name of the model that finds the words: a Grounding DINO or SAM 3."""
    box3d: UseAppendAction[tuple[str, ...]] = ()
    """x0,y0,z0,x1,y1,z1 in world units: all Gaussians inside, of any object. May be repeated."""
    sphere: UseAppendAction[tuple[str, ...]] = ()
    """x,y,z,RADIUS in world units; or VIEW:x,y,RADIUS around what shows at that pixel. May be
    repeated."""
    rows: UseAppendAction[tuple[Path, ...]] = ()
    """File of row numbers or a mask (.npz, .npy), as `export` writes objects, or a .ply in
    which SuperSplat has a selection. May be repeated."""
    plus: UseAppendAction[tuple[tuple[str, ...], ...]] = ()
    """Names of earlier selections to add, several or one at a time."""
    minus: UseAppendAction[tuple[tuple[str, ...], ...]] = ()
    """Names of earlier selections to remove, several or one at a time."""
    all: bool = False
    """Everything."""
    background: bool = False
    """What belongs to no object: a table, a wall. Take parts of it away with --minus."""
    grow: float | None = None
    """Add Gaussians close by: 0.05 reaches 5 % of the object's extent."""
    shrink: float | None = None
    """Remove Gaussians close to anything else: 0.02 reaches 2 % of the object's extent."""
    threshold: float = 0.5
    """Probability of the object above which a Gaussian belongs to it."""
    keep_outliers: bool = False
    """Keep Gaussians that lie apart from the rest of the object."""
    picture: bool = True
    """Draw no picture of it into the scene."""

    def run(self) -> Answer:
        from stylesplat.io.scene_folder import object_record

        selection_file(self.folder, self.name)  # raises before the work
        after = self.rewrite(self._select)
        picture = self._draw() if self.picture and self.json else None
        found = after.objects[self.name]
        within = [
            name
            for name, each in after.objects.items()
            if each.mask[found.mask].all() and each.mask.sum() > found.mask.sum()
        ]
        values = {"name": self.name, **object_record(found), "within": within}
        lines = [f"{self.name}: {values['gaussians']:,} Gaussians."]
        lines += [
            f"All of them are part of {whole}, too. With --of {whole} the rest stays its own; "
            f"--minus {self.name} takes them away from another selection."
            for whole in within
        ]
        values |= {"scene": self.folder, "picture": picture}
        return Answer(values, lines, [stylize_command(self.folder, self.name)])

    def after_answer(self, values: dict[str, Any]) -> None:
        if self.picture and not self.json and (picture := self._draw()):
            what = "the selected Gaussians in colour, in blue those of them that get no paint"
            say(f"Picture: {picture}, {what}.")

    def _select(self, scene: "ss.Scene") -> "ss.Scene":
        arguments = signature(ss.select).parameters
        given = {name: getattr(self, name) for name in arguments if hasattr(self, name)}
        given |= {name: [*chain(*given[name])] for name in ("id", "plus", "minus")}
        given |= {"scene": scene, "remove_outliers": not self.keep_outliers}
        return ss.select(**given)

    def _draw(self) -> Path | None:
        """Draw the selection in the scene as it is saved; None if there is no picture."""
        from stylesplat.figures.sheets import selection_picture
        from stylesplat.io.images import write_image
        from stylesplat.selection.resolve import find_object

        with optional_picture(self.name):
            scene = ss.open(self.folder)
            picked = scene.to_splats(find_object(scene, self.name))
            picture = selection_picture(scene.splats, scene.cameras, picked)
            if picture is None:
                say(f"{self.name} shows in none of the views, so there is no picture of it.")
                return None
            target = selection_file(self.folder, self.name)
            with locked_folder(self.folder):
                write_image(picture, target)
            return target
        return None


@dataclass(frozen=True)
class Rename(EditingCommand):
    """Give an object of a scene another name.

    Example: stylesplat rename garden-scene object vase
    """

    old: Positional[str]
    """The object's name."""
    new: Positional[str]
    """Its new name."""

    def run(self) -> Answer:
        from stylesplat.io.scene_folder import object_record

        after = self.rewrite(lambda scene: ss.rename(scene, self.old, self.new))
        picture = selection_file(self.folder, self.new)
        values = {"name": self.new, "was": self.old, **object_record(after.objects[self.new])}
        values |= {"scene": self.folder, "picture": picture if picture.is_file() else None}
        line = f"{self.old} is called {self.new} now."
        return Answer(values, [line], [stylize_command(self.folder, self.new)])


@dataclass(frozen=True)
class Delete(EditingCommand):
    """Delete the name of an object; its Gaussians stay, and so does their paint.

    Example: stylesplat delete garden-scene lid
    """

    name: Positional[str]
    """The object's name."""

    def run(self) -> Answer:
        after = self.rewrite(lambda scene: ss.delete(scene, self.name))
        left = ", ".join(after.objects) or "none"
        line = f"{self.folder}: deleted the name {self.name!r}. Names: {left}."
        values = {"scene": self.folder, "deleted": self.name, "names": [*after.objects]}
        return Answer(values, [line])

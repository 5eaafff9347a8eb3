"""`stylesplat select`."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.next_steps import next_lines, stylize_command
from stylesplat.cli.optional_pictures import told_if_missing
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose
from stylesplat.cli.parse import parse_box, parse_box3d, parse_point, parse_sphere
from stylesplat.cli.results import Answer
from stylesplat.cli.rewriting import rewritten
from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene

PICTURES = "selections"  # the folder inside a scene


def picture_of(scene: Path, name: str) -> Path:
    """Where the picture of a selection lies.

    Raises:
        StyleSplatError: If the folder of pictures leads out of the scene.
    """
    from stylesplat.io.files import file_stem, inside

    return inside(scene, f"{PICTURES}/{file_stem(name)}.png")


@dataclass(frozen=True)
class Select:
    """Name an object of a scene, by label id, places in photos, words, or a shape in the world.

    What is named more than once is united: `--id 3 --plus lid --minus lamp`.

    Example: stylesplat select garden-scene --name vase --point IMG_0007.jpg:640,420
    """

    first: ClassVar = ("id", "box", "point", "text")
    scene: Positional[Path]
    """Folder of the scene."""
    name: str
    """What to call the object."""
    id: tuple[int, ...] = ()
    """Label ids, as `objects` lists them, several or one at a time."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x0,y0,x1,y1 in the photo's pixels at full size: the object that shows most inside. May
    be repeated."""
    point: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x,y in the photo's pixels: the object that shows there. May be repeated."""
    not_point: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x,y of an object that is not meant. May be repeated."""
    text: UseAppendAction[tuple[str, ...]] = ()
    """A few words: the object that they mean, if it is clear which one. May be repeated."""
    model: str | None = None
    """Folder or hub name of the model that finds the words: a Grounding DINO or SAM 3."""
    box3d: UseAppendAction[tuple[str, ...]] = ()
    """x0,y0,z0,x1,y1,z1 in world units: what lies inside, whatever object it is. May be
    repeated."""
    sphere: UseAppendAction[tuple[str, ...]] = ()
    """x,y,z,RADIUS in world units; or VIEW:x,y,RADIUS around what shows at that pixel. May be
    repeated."""
    rows: UseAppendAction[tuple[Path, ...]] = ()
    """File of row numbers or a mask (.npz, .npy, .json), as `export` writes objects, or a .ply in
    which SuperSplat has a selection. May be repeated."""
    plus: tuple[str, ...] = ()
    """Names of earlier selections that belong to it, several or one at a time."""
    minus: tuple[str, ...] = ()
    """Names of earlier selections that do not, likewise."""
    all: FlagCreatePairsOff[bool] = False
    """Everything."""
    background: FlagCreatePairsOff[bool] = False
    """What belongs to no object: a table, a wall. Take parts of it away with --minus."""
    grow: float | None = None
    """Take in what lies close by: 0.05 reaches 5 % of the object's extent."""
    shrink: float | None = None
    """Give up what lies close to anything else: 0.02 reaches 2 % of the object's extent."""
    threshold: float = 0.5
    """Probability of the object above which a Gaussian belongs to it."""
    keep_outliers: FlagCreatePairsOff[bool] = False
    """Keep Gaussians that lie apart from the rest of the object."""
    picture: FlagCreatePairsOff[bool] = True
    """Draw no picture of it. Else it is drawn into the scene."""
    output: OptionalOutput = None
    """Folder of a scene to make; without it the scene itself is changed."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.atomic import changing

        if self.model is not None and not self.text:
            raise StyleSplatError("--model finds what --text says. Pass --text, or no --model.")
        folder = self.output or self.scene
        target = picture_of(folder, self.name)
        with changing(folder):
            after = rewritten(
                self.scene,
                self.output,
                self._selected,
                overwrite=self.overwrite,
                names_only=not self.text,  # words are looked for in pictures
            )
            with suppress(OSError):
                target.unlink()  # it shows what was called so before
        how = after.objects[self.name].how
        result = {"name": self.name, **how, "scene": folder, "picture": None}
        if self.picture and (self.json or self.verbose):  # these name the picture: it is there
            result["picture"] = self._draw(target)
        elif self.picture:
            return Answer(result, partial(self._show, target))
        return result

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{self.name}: {result['gaussians']:,} Gaussians."
        if result["picture"]:
            yield self._pictured(result["picture"])
        yield from next_lines(stylize_command(result["scene"], self.name))

    def _selected(self, scene: "Scene") -> "Scene":
        from stylesplat.verbs.select import select

        return select(
            scene,
            self.name,
            id=self.id,
            box=[(view, *numbers) for view, numbers in map(parse_box, self.box)],
            point=[(view, *numbers) for view, numbers in map(parse_point, self.point)],
            not_point=[(view, *numbers) for view, numbers in map(parse_point, self.not_point)],
            text=self.text,
            box3d=[*map(parse_box3d, self.box3d)],
            sphere=[
                (view, *numbers) if view else numbers
                for view, numbers in map(parse_sphere, self.sphere)
            ],
            rows=self.rows,
            plus=self.plus,
            minus=self.minus,
            all=self.all,
            background=self.background,
            grow=self.grow,
            shrink=self.shrink,
            threshold=self.threshold,
            remove_outliers=not self.keep_outliers,
            model=self.model,
        )

    def _show(self, target: Path) -> None:
        from stylesplat.progress import say

        if self._draw(target):
            say(self._pictured(target))

    def _pictured(self, target: Path) -> str:
        return f"Picture: {target}, in colour what was picked, in blue what of it gets no paint."

    def _draw(self, target: Path) -> Path | None:
        """Draw it, in the scene as it is saved; the picture if there is one."""
        from stylesplat.figures.sheets import selection_picture
        from stylesplat.io.atomic import changing
        from stylesplat.io.images import write_image
        from stylesplat.io.scene_folder import open
        from stylesplat.progress import say
        from stylesplat.selection.choose import find_object

        with told_if_missing(self.name):  # the selection is saved
            scene = open(self.output or self.scene)
            picked = find_object(scene, self.name)
            picture = selection_picture(scene.splats, scene.cameras, picked)
            if picture is None:
                say(f"{self.name} shows in none of the views, so there is no picture of it.")
                return None
            with changing(self.output or self.scene), changing(target):
                write_image(picture, target)
            return target
        return None

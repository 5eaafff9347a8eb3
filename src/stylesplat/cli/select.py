"""`stylesplat select`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.next_steps import next_lines, stylize_command
from stylesplat.cli.options import Json, Verbose
from stylesplat.cli.parse import parse_box, parse_box3d, parse_point, parse_sphere
from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene

PICTURES = "selections"  # the folder inside a scene


@dataclass(frozen=True)
class Select:
    """Name an object of a scene, by label id, places in photos, words, or a shape in the world.

    What is named more than once is united: `--id 3 --plus lid --minus lamp`.

    Example: stylesplat select garden-scene --name vase --point IMG_0007.jpg:640,420
    """

    scene: Positional[Path]
    """Folder of the scene."""
    name: str
    """What to call the object."""
    id: tuple[int, ...] = ()
    """Label ids, as `objects` lists them."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x0,y0,x1,y1 in photo pixels: the object that shows most inside. May be repeated."""
    point: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x,y in the photo's pixels: the object that shows there. May be repeated."""
    not_point: UseAppendAction[tuple[str, ...]] = ()
    """VIEW:x,y of an object that is not meant. May be repeated."""
    text: str | None = None
    """A few words: the object that they mean, if it is clear which one."""
    model: str | None = None
    """Folder or hub name of the model that finds the words: a Grounding DINO or SAM 3."""
    box3d: str | None = None
    """x0,y0,z0,x1,y1,z1 in world units: what lies inside, whatever object it is."""
    sphere: str | None = None
    """x,y,z,RADIUS in world units; or VIEW:x,y,RADIUS around what shows at that pixel."""
    plus: tuple[str, ...] = ()
    """Names of earlier selections that belong to it."""
    minus: tuple[str, ...] = ()
    """Names of earlier selections that do not."""
    grow: float | None = None
    """Take in what lies close by: 0.05 reaches 5 % of the object's extent."""
    shrink: float | None = None
    """Give up what lies close to anything else: 0.02 reaches 2 % of the object's extent."""
    threshold: float = 0.5
    """Probability of the object above which a Gaussian belongs to it."""
    keep_outliers: FlagCreatePairsOff[bool] = False
    """Keep Gaussians that lie apart from the rest of the object."""
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.files import file_stem, inside
        from stylesplat.io.recovery import changing
        from stylesplat.io.scene_folder import open, revise
        from stylesplat.verbs.select import select

        if self.model is not None and self.text is None:
            raise StyleSplatError("--model finds what --text says. Pass --text, or no --model.")
        target = inside(self.scene, f"{PICTURES}/{file_stem(self.name)}.png")
        with changing(self.scene):  # from reading on, so that no other's selection is lost
            before = open(self.scene)
            after = select(
                before,
                self.name,
                id=self.id,
                box=[(view, *numbers) for view, numbers in map(parse_box, self.box)],
                point=[(view, *numbers) for view, numbers in map(parse_point, self.point)],
                not_point=[(view, *numbers) for view, numbers in map(parse_point, self.not_point)],
                text=self.text,
                box3d=parse_box3d(self.box3d) if self.box3d else (),
                sphere=self._sphere(),
                plus=self.plus,
                minus=self.minus,
                grow=self.grow,
                shrink=self.shrink,
                threshold=self.threshold,
                remove_outliers=not self.keep_outliers,
                model=self.model,
            )
            revise(before, after, self.scene)
            picture = self._draw(after, target)
        return {"name": self.name, **after.objects[self.name].how, "picture": picture}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        yield f"{self.name}: {result['gaussians']:,} Gaussians."
        if result["picture"]:
            yield f"Picture: {result['picture']}, in colour what was picked."
        yield from next_lines(stylize_command(self.scene, self.name))

    def _sphere(self) -> tuple[Any, ...] | None:
        if not self.sphere:
            return None
        view, numbers = parse_sphere(self.sphere)
        return (view, *numbers) if view else numbers

    def _draw(self, scene: "Scene", target: Path) -> Path | None:
        from stylesplat.drawing.selection_picture import selection_picture
        from stylesplat.io.images import write_image
        from stylesplat.io.recovery import changing
        from stylesplat.progress import say

        picked = scene.objects[self.name].picked
        picture = selection_picture(scene.splats, scene.cameras, picked)
        if picture is None:
            say(f"{self.name} shows in none of the views, so there is no picture of it.")
            target.unlink(missing_ok=True)
            return None
        with changing(target):
            write_image(picture, target)
        return target

"""Results of commands: answers, scenes that are written, and the pictures in them."""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import stylesplat as ss
from stylesplat.cli.exit_status import user_message
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.progress import say

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from torch import Tensor

    from stylesplat.stylization.views import Box

T = TypeVar("T")
BEFORE_AFTER = "before_after.png"
PHOTO_AND_RENDER = "photo_and_render.png"
VIEW = "view.png"


class Answer(dict[str, Any]):
    """A result that is printed before all is done, so that nobody waits for the rest."""

    def __init__(self, result: Mapping[str, Any], rest: Callable[[], None]) -> None:
        super().__init__(result)
        self.rest = rest
        """Does what is left to do."""


def save_or_rescue(scene: "ss.Scene", output: Path, *, overwrite: bool) -> None:
    """Save a scene, or if that fails save it in the temporary directory."""
    from stylesplat.io.scene_folder import save

    write_or_rescue(
        lambda place, replace: save(scene, place, overwrite=replace),
        output,
        overwrite=overwrite,
        what="The scene is",
    )


def write_or_rescue(
    write: Callable[[Path, bool], T], output: Path, *, overwrite: bool, what: str
) -> T:
    """Write a result, or if that fails write it to the temporary directory, and raise the error.

    `write` takes a path, and whether it may exist; `what` is the result, to begin a sentence.
    """
    try:
        return write(output, overwrite)
    except StyleSplatError as error:
        rescued = Path(tempfile.mkdtemp(prefix="stylesplat-")) / output.resolve().name
        try:
            write(rescued, False)
        except StyleSplatError:
            shutil.rmtree(rescued.parent, ignore_errors=True)
            raise error from None
        raise StyleSplatError(f"{error} {what} in {rescued}: move it from there.") from error


def rewrite_scene(
    source: Path,
    output: Path | None,
    change: "Callable[[ss.Scene], ss.Scene]",
    *,
    overwrite: bool,
    names_only: bool = False,
) -> "ss.Scene":
    """Open a scene, change it, and save it to another folder, or in its own without `output`.

    With `names_only` the higher bands of colour are not read: nothing but names may change.
    """
    from stylesplat.io.atomic import changing, refuse_occupied, refuse_unwritable
    from stylesplat.io.kinds import SCENE
    from stylesplat.io.scene_folder import open_without_bands, revise

    with changing(output or source):  # from reading on, so that no other process's change is lost
        if output is not None:
            refuse_occupied(output, marker=SCENE, overwrite=overwrite)
        bands = output is not None or not names_only
        before = ss.open(source) if bands else open_without_bands(source)
        if output is None:
            refuse_unwritable(source)
        after = change(before)
        assert bands or after.splats is before.splats, "bands that were not read would be lost"
        if output is None:
            revise(before, after, source)
        else:
            ss.save(after, output, overwrite=overwrite)
    return after


def draw_before_after(
    scene: "ss.Scene",
    folder: Path,
    *,
    surveys: "Mapping[str, Sequence[Box]] | None" = None,
    device: str = "auto",
) -> dict[str, Any]:
    """Draw a painted scene before and after, for `before_after_line`."""
    from stylesplat.figures.sheets import before_after

    views = list[str]()

    def draw() -> "UInt8[Tensor, 'H W 3'] | None":
        found = before_after(scene, surveys=surveys, device=device)
        if found is None:
            return None
        views.append(found[0])
        return found[1]

    path = _write_picture(draw, folder / BEFORE_AFTER)
    return {"before_after": path} | ({"before_after_view": views[0]} if path else {})


def before_after_line(result: Mapping[str, Any]) -> Iterator[str]:
    """Where that picture is and which view it shows, if there is one."""
    if result["before_after"]:
        yield f"Picture: {result['before_after']} (view {result['before_after_view']})"


def describe_scene(
    scene: "ss.Scene", capture: "ss.Capture | None", folder: Path, *, device: str = "auto"
) -> dict[str, Any]:
    """Describe a new scene, and draw one of its views beside the photo, a held-out one if any."""
    from stylesplat.figures.sheets import beside_photo, one_view

    names = scene.held_out or scene.cameras.names
    name = names[len(names) // 2]
    if capture is None:
        picture = _write_picture(lambda: one_view(scene, name, device=device), folder / VIEW)
    else:
        picture = _write_picture(
            lambda: beside_photo(scene, capture, name, device=device), folder / PHOTO_AND_RENDER
        )
    return {
        "scene": folder,
        "picture": picture,
        "objects": sorted(scene.objects),
        "labelled": scene.splats.classifier is not None,
    }


@contextmanager
def optional_picture(of: str = "") -> Iterator[None]:
    """Draw a picture within the block; if that fails, say so and go on: the result is saved."""
    try:
        yield
    except (StyleSplatError, MemoryError, RuntimeError, OSError) as error:  # RuntimeError: CUDA
        what = f"There is no picture of {of}" if of else "There is no picture"
        say(f"{what}: {user_message(error) or reason(error)}")


def _write_picture(
    draw: "Callable[[], UInt8[Tensor, 'H W 3'] | None]", target: Path
) -> Path | None:
    """The picture's file; None if there is nothing to draw, or drawing fails."""
    from stylesplat.io.atomic import changing
    from stylesplat.io.images import write_image

    with optional_picture(), changing(target):
        picture = draw()
        if picture is None:
            target.unlink(missing_ok=True)
            return None
        write_image(picture, target)
        return target
    return None

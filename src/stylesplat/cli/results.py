"""What took long to make is not lost because its place fails in the end."""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene

T = TypeVar("T")


class Answer(dict[str, Any]):
    """A result that is printed before all is done, so that nobody waits for the rest."""

    def __init__(self, result: Mapping[str, Any], rest: Callable[[], None]) -> None:
        super().__init__(result)
        self.rest = rest
        """What is left to do."""


def save_or_rescue(scene: "Scene", output: Path, *, overwrite: bool) -> None:
    """Save a scene; where that fails, in the temporary directory; see `write_or_rescue`."""
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
    """Write what was made; where that fails, in the temporary directory.

    Args:
        write: Writes it to a place, and is told whether that may hold something.
        output: The place.
        overwrite: Whether it may.
        what: What it is, to begin a sentence.

    Raises:
        StyleSplatError: If it could not be written to its place; it says where it is instead.
    """
    try:
        return write(output, overwrite)
    except StyleSplatError as error:
        rescued = _rescued(write, output.resolve().name)
        if rescued is None:
            raise
        raise StyleSplatError(f"{error} {what} in {rescued}: move it from there.") from error


def _rescued(write: Callable[[Path, bool], T], name: str) -> Path | None:
    """Where it is; None if there is no room for it either."""
    try:
        place = Path(tempfile.mkdtemp(prefix="stylesplat-"))
    except OSError:
        return None
    try:
        write(place / name, False)
    except StyleSplatError:
        shutil.rmtree(place, ignore_errors=True)
        return None
    return place / name

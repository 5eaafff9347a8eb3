"""What took long to make is not lost because its place fails in the end."""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene


class Answer(dict[str, Any]):
    """A result that is printed before all is done, so that nobody waits for the rest."""

    def __init__(self, result: Mapping[str, Any], rest: Callable[[], None]) -> None:
        super().__init__(result)
        self.rest = rest
        """What is left to do."""


def save_or_rescue(scene: "Scene", output: Path, *, overwrite: bool) -> None:
    """Save a scene; where that fails, in the temporary directory.

    Raises:
        StyleSplatError: If it could not be saved in its place; it says where it is instead.
    """
    from stylesplat.io.scene_folder import save

    try:
        save(scene, output, overwrite=overwrite)
    except StyleSplatError as error:
        rescued = _rescued(scene, output.resolve().name)
        if rescued is None:
            raise
        raise StyleSplatError(f"{error} The scene is in {rescued}: move it from there.") from error


def _rescued(scene: "Scene", name: str) -> Path | None:
    """Where the scene is; None if there is no room for it either."""
    from stylesplat.io.scene_folder import save

    try:
        place = Path(tempfile.mkdtemp(prefix="stylesplat-"))
    except OSError:
        return None
    try:
        save(scene, place / name)
    except StyleSplatError:
        shutil.rmtree(place, ignore_errors=True)
        return None
    return place / name

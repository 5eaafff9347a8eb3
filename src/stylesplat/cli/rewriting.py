"""A scene that a command changes: where it is, or in another folder that is made."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene


def rewritten(
    source: Path,
    output: Path | None,
    change: "Callable[[Scene], Scene]",
    *,
    overwrite: bool,
    names_only: bool = False,
) -> "Scene":
    """Read a scene, change it, and write it.

    Args:
        source: Its folder.
        output: The folder to make, and the first one stays as it is; None writes into that.
        change: Gives the scene that is wanted.
        overwrite: Whether `output` may hold something.
        names_only: Whether only objects and their names change, and nothing is drawn for that.

    Returns:
        The scene that is written; without higher bands of colour if they were not needed.

    Raises:
        StyleSplatError: If `change` does, or a folder cannot be read or written, or `output`
            holds something that may not be replaced.
    """
    from stylesplat.io.atomic import changing, refuse_occupied, refuse_unwritable
    from stylesplat.io.kinds import SCENE
    from stylesplat.io.scene_folder import open, open_without_bands, revise, save

    with changing(output or source):  # from reading on, so that no other's change is lost
        if output is not None:
            refuse_occupied(output, marker=SCENE, overwrite=overwrite)
        bands = output is not None or not names_only
        before = open(source) if bands else open_without_bands(source)
        if output is None:
            refuse_unwritable(source)
        after = change(before)
        assert bands or after.splats is before.splats, "what was not read would be lost"
        if output is None:
            revise(before, after, source)
        else:
            save(after, output, overwrite=overwrite)
    return after

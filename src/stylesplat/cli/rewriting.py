"""A scene that a command changes: where it is, or in another folder that is made."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene


def rewritten(
    source: Path, output: Path | None, change: "Callable[[Scene], Scene]", *, overwrite: bool
) -> "Scene":
    """Read a scene, change it, and write it.

    Args:
        source: Its folder.
        output: The folder to make, and the first one stays as it is; None writes into that.
        change: Gives the scene that is wanted.
        overwrite: Whether `output` may hold something.

    Returns:
        The scene that is written.

    Raises:
        StyleSplatError: If `change` does, or a folder cannot be read or written, or `output`
            holds something that may not be replaced.
    """
    from stylesplat.io.folders import refuse_occupied
    from stylesplat.io.places import refuse_unwritable
    from stylesplat.io.recovery import changing
    from stylesplat.io.scene_folder import SCENE, open, revise, save

    with changing(output or source):  # from reading on, so that no other's change is lost
        if output is not None:
            refuse_occupied(output, marker=SCENE, overwrite=overwrite)
        before = open(source)
        if output is None:
            refuse_unwritable(source)
        after = change(before)
        if output is None:
            revise(before, after, source)
        else:
            save(after, output, overwrite=overwrite)
    return after

"""`export`: splats in the formats of other programs."""

from pathlib import Path

from stylesplat.io.recovery import changing
from stylesplat.io.splats.splat_files import write_splats
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats


def export(what: Scene | Splats, path: Path | str, *, overwrite: bool = False) -> None:
    """Write a scene's splats for a viewer, in the format that the file's suffix names.

    Args:
        what: A scene, or splats alone.
        path: A file name ending in `.ply`, which keeps every bit; in `.spz`, about ten times
            smaller; or in `.splat`, one colour per Gaussian.
        overwrite: Whether a file of that name may be replaced.

    Raises:
        StyleSplatError: If the suffix is none of these, the file exists and may not be replaced,
            it cannot be written, or the splats reach farther than `.spz` can express.
    """
    splats = what if isinstance(what, Splats) else what.splats
    with changing(path):
        write_splats(splats, path, overwrite=overwrite)

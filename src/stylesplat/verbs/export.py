"""`export`: splats in the formats of other programs."""

from pathlib import Path

from stylesplat.io.recovery import changing
from stylesplat.io.splats.splat_files import write_splats
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats


def export(
    what: Scene | Splats,
    path: Path | str,
    *,
    overwrite: bool = False,
    sh_degree: int | None = None,
) -> None:
    """Write a scene's splats for a viewer, in the format that the file's suffix names.

    Args:
        what: A scene, or splats alone.
        path: A file name ending in `.ply`, which keeps every bit; in `.compressed.ply`, as
            SuperSplat compresses, four times smaller; in `.spz`, about ten times smaller; or in
            `.splat`, one colour per Gaussian.
        overwrite: Whether a file of that name may be replaced.
        sh_degree: Up to which degree, 0 to 3, colours may depend on where they are seen from; what
            is above is left out. By default nothing is: `.ply` has the columns of degree 3, as
            INRIA's, the smaller ones have as many as are not all zero.

    Raises:
        StyleSplatError: If the suffix is none of these or has no such degree, the file exists and
            may not be replaced, it cannot be written, or the splats reach farther than `.spz` can
            express.
    """
    splats = what if isinstance(what, Splats) else what.splats
    with changing(path):
        write_splats(splats, path, overwrite=overwrite, sh_degree=sh_degree)

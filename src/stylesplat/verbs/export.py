"""`export`: splats in the formats of other programs, or as a page that shows them."""

from pathlib import Path

from stylesplat.drawing.web_page import SUFFIX, write_page
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
            SuperSplat compresses, four times smaller; in `.spz`, about ten times smaller; in
            `.splat`, one colour per Gaussian; in `.glb`, glTF with Khronos' KHR_gaussian_splatting,
            all as float32; or in `.html`, a page that any browser opens from
            the disk, without a network, and that compares a styled scene with what it was before.
        overwrite: Whether a file of that name may be replaced.
        sh_degree: Up to which degree, 0 to 3, colours may depend on where they are seen from; what
            is above is left out. By default nothing is: `.ply` has the columns of degree 3, as
            INRIA's, the others have as many as are not all zero.

    Raises:
        StyleSplatError: If the suffix is none of these or has no such degree, the file exists and
            may not be replaced, it cannot be written, the splats reach farther than `.spz` can
            express or are none that a `.glb` can hold, or nothing would show on a page.
    """
    path = Path(path)
    with changing(path):
        if path.suffix.lower() == SUFFIX:
            write_page(what, path, overwrite=overwrite, sh_degree=sh_degree)
        else:
            splats = what if isinstance(what, Splats) else what.splats
            write_splats(splats, path, overwrite=overwrite, sh_degree=sh_degree)
